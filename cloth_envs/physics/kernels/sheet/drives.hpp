// How handles and bodies move through a frame.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <vector>

#include "bodies.hpp"
#include "cubic.hpp"
#include "sheet.hpp"

namespace minicloth {

// A driven vertex; one that is held still costs two stores a substep. A soft one is drawn to its path by a spring.
struct Handle {
  int at;  // its place in planes
  bool moves;
  Cubic path[3];
  double frame_dt;
  double rate[3];  // the spring's stiffness along an axis over the vertex's mass [1/s^2], infinite if it is firm
  bool firm() const { return std::isinf(rate[0]); }
  // Of the way to its path, what a soft one goes at the end of a step of dt: implicit in the spring, stable at any
  // rate.
  double share(int axis, double dt) const { return dt * dt * rate[axis] / (1 + dt * dt * rate[axis]); }
  double position(int axis, double s) const { return moves ? path[axis].position(s) : path[axis].p0; }
  double velocity(int axis, double s) const { return moves ? path[axis].velocity(s) / frame_dt : 0.0; }
};

// The handles, where place(vertex) says, of a cloth whose stretch stiffness over areal density is `stiffness`
// [m^2/s^2]. A firm one's path starts where it is; a soft one's, where it would be had it moved with its lead alone.
template <class T, class Place>
std::vector<Handle> handles_of(const Sheet& sheet, const Frame<T>& f, double stiffness, const Place& place) {
  const int n = sheet.rows * sheet.cols;
  std::vector<Handle> handles(sheet.handles.size());
  for (std::size_t h = 0; h < handles.size(); ++h) {
    const double* hold = sheet.hold.data() + 3 * h;
    handles[h] = {place(sheet.handles[h]), false, {}, sheet.frame_dt, {}};
    for (int k = 0; k < 3; ++k) handles[h].rate[k] = std::isinf(hold[k]) ? hold[k] : hold[k] * stiffness;
    const std::size_t lead = handles[h].firm() ? h : sheet.lead[h];
    for (int k = 0; k < 3; ++k) {
      const int i = k * n + sheet.handles[lead];
      const double end = f.handle_x[3 * h + k], offset = end - f.handle_x[3 * lead + k];
      const Cubic path = {f.x[i] + offset, f.v[i] * sheet.frame_dt, end, f.handle_v[3 * h + k] * sheet.frame_dt};
      handles[h].path[k] = path;
      handles[h].moves |= path.p0 != path.p1 || path.v0 != 0 || path.v1 != 0;
    }
  }
  return handles;
}

// The firm ones alone.
template <class T>
void put_positions(const std::vector<Handle>& handles, double s, T* const (&x)[3]) {
  for (const Handle& h : handles)
    for (int k = 0; h.firm() && k < 3; ++k) x[k][h.at] = T(h.position(k, s));
}
template <class T>
void put_velocities(const std::vector<Handle>& handles, double s, T* const (&v)[3]) {
  for (const Handle& h : handles)
    for (int k = 0; h.firm() && k < 3; ++k) v[k][h.at] = T(h.velocity(k, s));
}

// The largest component of the velocities of cloth, handles and bodies in a frame [m/s]; NaN does not count.
template <class T>
double fastest(const Sheet& sheet, const Frame<T>& f) {
  typedef T Four __attribute__((vector_size(4 * sizeof(T))));
  const int n = sheet.rows * sheet.cols;
  T most = 0;
  const auto take = [&](double v) { most = std::fabs(T(v)) > most ? std::fabs(T(v)) : most; };
  Four high = {}, low = {};
  int i = 0;
  for (Four v; i + 4 <= 3 * n; i += 4) {
    std::memcpy(&v, f.v + i, sizeof v);
    high = v > high ? v : high, low = v < low ? v : low;
  }
  for (int k = 0; k < 4; ++k) take(high[k]), take(low[k]);
  for (; i < 3 * n; ++i) take(f.v[i]);
  for (std::size_t h = 0; h < sheet.handles.size(); ++h)
    for (int k = 0; k < 3; ++k) {
      take(f.handle_v[3 * h + k]);
      take((f.handle_x[3 * h + k] - f.x[k * n + sheet.handles[h]]) / sheet.frame_dt);
    }
  for (std::size_t b = 0; b < 6 * sheet.bodies.size(); ++b)
    take(f.body_v[b]), take(f.body_v_end[b]), take((f.body_x_end[b] - f.body_x[b]) / sheet.frame_dt);
  return most;
}

// The paths of the bodies' two points, (C, 2, 3).
template <class T>
std::vector<Cubic> body_paths(const Sheet& sheet, const Frame<T>& f) {
  std::vector<Cubic> paths(6 * sheet.bodies.size());
  for (std::size_t i = 0; i < paths.size(); ++i)
    paths[i] = {f.body_x[i], f.body_v[i] * sheet.frame_dt, f.body_x_end[i], f.body_v_end[i] * sheet.frame_dt};
  return paths;
}

// By how much a capsule turns about its axis, along that [rad], as the part across of an axis that goes from o0 to o1
// does while its own goes from a0 to a1. Less where the two are nearly parallel.
inline Vec<double> turned(const double (&a0)[2][3], const double (&a1)[2][3], const double (&o0)[2][3],
                          const double (&o1)[2][3]) {
  const Vec<double> from = vec(a0[1]) - vec(a0[0]), to = vec(a1[1]) - vec(a1[0]);
  const double from2 = dot(from, from), to2 = dot(to, to);
  if (from2 == 0 || to2 == 0) return {};
  const Vec<double> was = vec(o0[1]) - vec(o0[0]), is = vec(o1[1]) - vec(o1[0]);
  const Vec<double> across0 = was - (dot(was, from) / from2) * from, across1 = is - (dot(is, to) / to2) * to;
  const double least = kTurnLeast * dot(is, is), square = dot(across1, across1);
  return dot(to, cross(across0, across1)) / (to2 * std::max({square, least, 1e-300})) * to;
}

// Where bodies are, and by how much they turned since they were last somewhere.
class BodyPaths {
 public:
  template <class T>
  BodyPaths(const Sheet& sheet, const Frame<T>& f) : bodies_(&sheet.bodies), paths_(body_paths(sheet, f)) {
    now_.resize(sheet.bodies.size());
    to(0.0);
  }
  void to(double s) {
    before_ = now_;
    for (std::size_t i = 0; i < paths_.size(); ++i) now_[i / 6].p[i / 3 % 2][i % 3] = paths_[i].position(s);
  }
  // The least and the most of axis k of body b's ends between two places of the frame, and how far one goes.
  struct Range {
    double low, high, way;
  };
  Range range(std::size_t b, int k, double from, double to) const {
    Range all = {1e300, -1e300, 0};
    for (const std::size_t i : {6 * b + k, 6 * b + 3 + k}) {
      const auto [low, high] =
          std::minmax({paths_[i].position(from), paths_[i].position(0.5 * (from + to)), paths_[i].position(to)});
      all = {std::min(all.low, low), std::max(all.high, high), std::max(all.way, high - low)};
    }
    return all;
  }
  // Of body b, axis k of its end or point e; whether the ends move alike.
  double at(std::size_t b, int e, int k) const { return now_[b].p[e][k]; }
  bool round(std::size_t b) const {
    for (int k = 0; k < 3; ++k)
      if (!(paths_[6 * b + k] == paths_[6 * b + 3 + k])) return false;
    return true;
  }
  Vec<double> turn(std::size_t b) const {
    const int with = (*bodies_)[b].turns_with;
    return with < 0 ? Vec<double>{} : turned(before_[b].p, now_[b].p, before_[with].p, now_[with].p);
  }

 private:
  struct Ends {
    double p[2][3];
  };
  const std::vector<Body>* bodies_;
  std::vector<Cubic> paths_;
  std::vector<Ends> before_, now_;
};

// The bodies in one step after the other.
template <class T>
class MovingBodies {
 public:
  MovingBodies(const Sheet& sheet, const Frame<T>& f, double dt) : paths_(sheet, f) {
    for (const Body& body : sheet.bodies)
      steps_.push_back({body.plane, {}, {}, T(body.radius + sheet.thickness), T(body.friction), T(dt), {}});
    to(0.0);
  }
  // The step from where the last one ended to s.
  const std::vector<BodyStep<T>>& to(double s) {
    paths_.to(s);
    for (std::size_t b = 0; b < steps_.size(); ++b) {
      BodyStep<T>& body = steps_[b];
      for (int i = 0; i < 6; ++i) {
        T &before = body.before[i / 3][i % 3], &after = body.after[i / 3][i % 3];
        before = after, after = T(paths_.at(b, i / 3, i % 3));
      }
      const Vec<double> turn = paths_.turn(b);
      body.turn[0] = T(turn.x), body.turn[1] = T(turn.y), body.turn[2] = T(turn.z);
    }
    return steps_;
  }

 private:
  BodyPaths paths_;
  std::vector<BodyStep<T>> steps_;
};

}  // namespace minicloth
