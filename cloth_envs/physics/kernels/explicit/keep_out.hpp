// Contact of vertices with bodies. Included where it is compiled for an instruction set.
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

// Calls act(body) for those of `count` bodies whose bit is set, in turn.
template <class Act>
inline void each_of(std::uint64_t bodies, std::size_t count, const Act& act) {
  for (std::size_t first = 0; first < count; first += kBits)
    for (std::uint64_t left = bodies; left; left &= left - 1) {
      const std::size_t b = first + std::size_t(__builtin_ctzll(left));
      if (b >= count) break;
      act(b);
    }
}

// Vertices that may touch, from anywhere: elements of fields, and the bodies near them.
struct Touching {
  int at;
  std::uint64_t bodies;
};

// Some of them side by side: of a cloth in bands as many as there are lanes, of several cloths each in its own lane.
template <class T>
struct Together {
  int at[kLanes<T>];
  unsigned lanes = 0;  // that have one
  std::uint64_t bodies = 0;

  void add(const Touching& one, int lane) {
    if (!lanes)  // lanes that have none keep the vertex beside it, and what becomes of that is not kept
      for (int l = 0; l < kLanes<T>; ++l) at[l] = one.at / kLanes<T> * kLanes<T> + l;
    at[lane] = one.at, lanes |= 1u << lane, bodies |= one.bodies;
  }
};

template <class T>
void put_lanes(const Together<T>& some, T* to, const V3<T>& v) {
  constexpr int n = kLanes<T>;
  alignas(64) T all[3][n];
  store<T>(all[0], v.x), store<T>(all[1], v.y), store<T>(all[2], v.z);
  for (unsigned left = some.lanes; left; left &= left - 1) {
    const int l = __builtin_ctz(left);
    for (int k = 0; k < 3; ++k) to[some.at[l] + k * n] = all[k][l];
  }
}

// Contact of vertices that went for dt to where they are, with the bodies near them in turn, and then out of all of
// these.
template <class T>
Vertex<T> touch_near(std::uint64_t near, const std::vector<BodyLanes<T>>& bodies, const std::vector<Moving<T>>& moving,
                     const V<T>& dt, Vertex<T> now) {
  const V3<T> start = now.x - dt * now.v;
  each_of(near, bodies.size(), [&](std::size_t b) {
    if (any<T>(may_touch(moving[b], now.x, now.x - start))) now = touch(bodies[b], moving[b], start, now);
  });
  bool deep = bodies.size() > kBits || (near & (near - 1));
  for (int sweep = 0; deep && sweep < kSweeps; ++sweep) {
    deep = false;
    each_of(near, bodies.size(), [&](std::size_t b) { deep |= leave(moving[b], now.x); });
  }
  return now;
}

// Contact of all vertices of fields that a step took at v to x. Few of those near bodies touch one, in vectors far from
// each other: they are found first, by the body that they may touch, and then taken together. Where half of a vector
// may touch it is taken as it is.
template <class T>
void keep_out(const Strips<T>& s, const StepTerms<T>& p, const std::vector<BodyLanes<T>>& bodies,
              const std::vector<Near>& near, T* x, T* v, T* y) {
  constexpr int n = kLanes<T>;
  const V<T> dt = load(p.dt), damping = load(p.damping);
  const std::vector<Moving<T>>& moving = moving_bodies(bodies, p);
  thread_local std::vector<std::vector<Touching>> found;  // by body
  thread_local std::vector<Together<T>> together;
  found.resize(bodies.size()), together.clear();
  for (auto& one : found) one.clear();
  for (const Near& some : near) {
    const Vertex<T> at = {get<T>(x + some.at), get<T>(v + some.at)};
    const V3<T> way = dt * at.v;
    unsigned left = some.lanes;
    bool whole = false;
    each_of(some.bodies, bodies.size(), [&](std::size_t b) {
      if (whole) return;
      const auto touches = may_touch(moving[b], at.x, way);
      if (!any<T>(touches)) return;
      unsigned lanes = bits<T>(touches) & left;
      whole = left == some.lanes && 2 * __builtin_popcount(lanes) >= n;
      if (whole) return;
      left &= ~lanes;
      for (; lanes; lanes &= lanes - 1) found[b].push_back({some.at + __builtin_ctz(lanes), some.bodies});
    });
    if (!whole) continue;
    const Vertex<T> now = touch_near(some.bodies, bodies, moving, dt, at);
    set<T>(x + some.at, now.x), set<T>(v + some.at, now.v), set<T>(y + some.at, now.x + damping * now.v);
  }
  int filled[n] = {};  // of every lane, in bands of the first alone: those of all
  for (const auto& of_body : found)
    for (const Touching& one : of_body) {
      const int lane = s.banded ? filled[0] % n : one.at % n, number = s.banded ? filled[0]++ / n : filled[lane]++;
      if (number == int(together.size())) together.emplace_back();
      together[number].add(one, lane);
    }
  for (const Together<T>& some : together) {
    const auto get = [&](const T* from) -> V3<T> {
      return {gather<T>(from, some.at), gather<T>(from + n, some.at), gather<T>(from + 2 * n, some.at)};
    };
    const Vertex<T> now = touch_near<T>(some.bodies, bodies, moving, dt, {get(x), get(v)});
    put_lanes(some, x, now.x), put_lanes(some, v, now.v), put_lanes(some, y, now.x + damping * now.v);
  }
}

// At a frame's end: what contact leaves of velocities that go on for dt.
template <class T>
void rest(const Strips<T>& s, const Fields<T>& f, const StepTerms<T>& p, const std::vector<BodyLanes<T>>& bodies,
          const std::vector<Near>& near) {
  const V<T> dt = load(p.dt);
  for (const Near& some : near) {
    const V3<T> at = get<T>(f.x + some.at), u = get<T>(f.v + some.at);
    set<T>(f.y + some.at, V3<T>{at.x + dt * u.x, at.y + dt * u.y, at.z + dt * u.z});
  }
  keep_out(s, p, bodies, near, f.y, f.v, f.ahead);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
