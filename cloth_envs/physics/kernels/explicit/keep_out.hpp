// Contact of rows of vertices. Included where it is compiled for an instruction set.
#pragma once
#include <cstdint>

#include "../sheet/contact.hpp"
#include "core.hpp"
#include "ghosts.hpp"

namespace minicloth {
namespace LANES {
namespace {

// The bodies in a substep.
template <class T>
std::vector<Moving<T>>& moving_bodies(const std::vector<BodyLanes<T>>& bodies, const StepTerms<T>& p) {
  thread_local std::vector<Moving<T>> all;
  all.clear();
  for (const BodyLanes<T>& body : bodies) all.emplace_back(body, load(p.dt));
  return all;
}

// Contact of the `cols` vertices of a row that went at v for dt to x, with the bodies near them in turn, and then out
// of all of these.
template <class T>
void keep_out(const std::vector<BodyLanes<T>>& bodies, const std::uint64_t* near, const std::vector<Moving<T>>& moving,
              const StepTerms<T>& p, int cols, T* x, T* v, T* y) {
  constexpr int q = 3 * kLanes<T>;
  const V<T> dt = load(p.dt), damping = load(p.damping);
  const std::size_t count = bodies.size();
  for (int c = 0; c < cols; ++c, x += q, v += q, y += q) {
    const std::uint64_t mask = near[c];
    if (!mask) continue;
    const auto next = [&](std::size_t b) {  // the first from b on that is near
      while (b < count && !(mask >> b % kBits & 1)) ++b;
      return b;
    };
    Vertex<T> now = {get<T>(x), get<T>(v)};
    const V3<T> way = dt * now.v;
    std::size_t b = next(0);
    while (b < count && !may_touch(moving[b], now.x, way)) b = next(b + 1);
    if (b == count) continue;
    const V3<T> start = now.x - way;
    now = touch(bodies[b], moving[b], start, now);
    while ((b = next(b + 1)) < count)
      if (may_touch(moving[b], now.x, now.x - start)) now = touch(bodies[b], moving[b], start, now);
    bool deep = count > kBits || (mask & (mask - 1));
    for (int sweep = 0; deep && sweep < kSweeps; ++sweep) {
      deep = false;
      for (b = next(0); b < count; b = next(b + 1)) deep |= leave(moving[b], now.x);
    }
    set<T>(x, now.x), set<T>(v, now.v);
    set<T>(y, V3<T>{now.x.x + damping * now.v.x, now.x.y + damping * now.v.y, now.x.z + damping * now.v.z});
  }
}

// At a frame's end: what contact leaves of velocities that go on for dt.
template <class T>
void rest(const Strips<T>& s, const Fields<T>& f, const StepTerms<T>& p, const std::vector<BodyLanes<T>>& bodies,
          const Near& near) {
  constexpr int q = 3 * kLanes<T>;
  const V<T> dt = load(p.dt);
  const std::vector<Moving<T>>& moving = moving_bodies(bodies, p);
  for (int r = 0; r < s.rows; ++r) {
    T *const x = f.x + s.at(r, 0), *const v = f.v + s.at(r, 0), *const trial = f.y + s.at(r, 0);
    for (int i = 0; i < s.cols * q; i += q) {
      const V3<T> at = get<T>(x + i), u = get<T>(v + i);
      set<T>(trial + i, V3<T>{at.x + dt * u.x, at.y + dt * u.y, at.z + dt * u.z});
    }
    keep_out(bodies, near.bodies.data() + std::size_t(r) * s.cols, moving, p, s.cols, trial, v, f.low);
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
