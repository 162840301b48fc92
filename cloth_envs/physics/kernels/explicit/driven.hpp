// What moves lanes of cloths from outside during a frame: handles and bodies.
#pragma once
#include <algorithm>
#include <cstddef>
#include <vector>

#include "../sheet/drives.hpp"
#include "core.hpp"

namespace minicloth {

// The handles of all lanes.
template <class T>
class HeldVertices {
 public:
  void add(const Sheet& sheet, const Frame<T>& frame, const Material& m, const Strips<T>& s, int member) {
    const auto place = [&](int vertex) { return s.places[vertex] + member; };
    for (const Handle& h : handles_of(sheet, frame, m.stretch_stiffness / m.areal_density, place)) {
      if (h.moves || !h.firm())
        moving_.push_back(h);
      else
        still_.push_back({h.at, {T(h.path[0].p0), T(h.path[1].p0), T(h.path[2].p0)}});
    }
  }
  // At s of the frame, the end of a step of dt, which is 0 at the frame's end: firm ones are put on their paths, soft
  // ones drawn there.
  void hold(const Fields<T>& f, const StepTerms<T>& terms, int width, double s, double dt) const {
    for (const Still& h : still_)
      for (int k = 0, at = h.at; k < 3; ++k, at += width) f.x[at] = f.y[at] = h.x[k], f.v[at] = T(0);
    for (const Handle& h : moving_) {
      const T damping = terms.damping[h.at % width];
      for (int k = 0, at = h.at; k < 3; ++k, at += width) {
        T x = T(h.position(k, s)), v = T(h.velocity(k, s));
        if (!h.firm()) {
          const T drawn = dt > 0 ? T(h.share(k, dt) * (h.position(k, s) - f.x[at])) : T(0);
          x = f.x[at] + drawn, v = dt > 0 ? f.v[at] + T(drawn / dt) : f.v[at];
        }
        f.x[at] = x, f.v[at] = v, f.y[at] = x + damping * v;
      }
    }
  }
  // What the springs of soft ones, where they are at s, change of their velocities in dt. Half a step at a frame's end,
  // and less as much at its start, whose first step draws them for a whole one.
  void pull(const Fields<T>& f, int width, double s, double dt) const {
    for (const Handle& h : moving_)
      for (int k = 0, at = h.at; !h.firm() && k < 3; ++k, at += width)
        f.v[at] += T(dt * h.rate[k] * (h.position(k, s) - f.x[at]));
  }

 private:
  struct Still {
    int at;
    T x[3];
  };
  std::vector<Still> still_;
  std::vector<Handle> moving_;
};

// The bodies of all lanes in one substep after the other.
template <class T>
class LaneBodies {
 public:
  explicit LaneBodies(const Sheet& sheet) {
    for (const Body& body : sheet.bodies) {
      BodyLanes<T> lanes = {};
      lanes.shape = body.plane ? Shape::kPlane : Shape::kSphere;
      lanes.radius = T(body.radius + sheet.thickness), lanes.friction = T(body.friction);
      bodies_.push_back(lanes);
    }
  }
  // Those of lanes `first` to `last` - 1.
  void add(const Sheet& sheet, const Frame<T>& frame, int first, int last) {
    lanes_.push_back({first, last, BodyPaths(sheet, frame)});
    for (std::size_t b = 0; b < bodies_.size(); ++b)
      if (bodies_[b].shape == Shape::kSphere && !lanes_.back().paths.round(b)) bodies_[b].shape = Shape::kCapsule;
    to(0), to(0);
  }
  // The step from where the last one ended to s.
  const std::vector<BodyLanes<T>>& to(double s) {
    for (Bodies& one : lanes_) {
      one.paths.to(s);
      for (std::size_t b = 0; b < bodies_.size(); ++b) {
        BodyLanes<T>& body = bodies_[b];
        for (int i = 0; i < 6; ++i) {
          T *const before = body.before[i / 3][i % 3], *const after = body.after[i / 3][i % 3];
          const T at = T(one.paths.at(b, i / 3, i % 3));
          for (int l = one.first; l < one.last; ++l) before[l] = after[l], after[l] = at;
        }
        const Vec<double> turn = one.paths.turn(b);
        for (int l = one.first; l < one.last; ++l)
          body.turn[0][l] = T(turn.x), body.turn[1][l] = T(turn.y), body.turn[2][l] = T(turn.z);
      }
    }
    return bodies_;
  }
  // Where they will be until `to`.
  void look(double from, double to) {
    for (const Bodies& one : lanes_)
      for (std::size_t b = 0; b < bodies_.size(); ++b)
        for (int k = 0; k < 3; ++k) {
          BodyLanes<T>& body = bodies_[b];
          const auto [low, high, way] = one.paths.range(b, k, from, to);
          for (int l = one.first; l < one.last; ++l)
            body.low[k][l] = T(low), body.high[k][l] = T(high), body.way[l] = std::max(k ? body.way[l] : T(0), T(way));
        }
  }

 private:
  struct Bodies {
    int first, last;
    BodyPaths paths;
  };
  std::vector<BodyLanes<T>> bodies_;
  std::vector<Bodies> lanes_;
};

}  // namespace minicloth
