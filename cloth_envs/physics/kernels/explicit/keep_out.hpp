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
  int at[kLanes<T>], count = 0;
  unsigned lanes = 0;  // that have one
  std::uint64_t bodies = 0;

  void add(const Touching& one, int lane) {
    if (!lanes)  // lanes that have none keep the vertex beside it, and what becomes of that is not kept
      for (int l = 0; l < kLanes<T>; ++l) at[l] = one.at / kLanes<T> * kLanes<T> + l;
    at[lane] = one.at, lanes |= 1u << lane, bodies |= one.bodies;
  }
};

// Contact of vertices that went for dt to where they are, with the bodies near them in turn, and then out of all of
// these.
template <class T>
void touch_together(const Together<T>& some, const std::vector<BodyLanes<T>>& bodies,
                    const std::vector<Moving<T>>& moving, const StepTerms<T>& p, T* x, T* v, T* y) {
  constexpr int n = kLanes<T>;
  const V<T> damping = load(p.damping);
  const auto get = [&](const T* from) -> V3<T> {
    return {gather<T>(from, some.at), gather<T>(from + n, some.at), gather<T>(from + 2 * n, some.at)};
  };
  Vertex<T> now = {get(x), get(v)};
  const V3<T> start = now.x - load(p.dt) * now.v;
  each_of(some.bodies, bodies.size(), [&](std::size_t b) {
    if (any<T>(may_touch(moving[b], now.x, now.x - start))) now = touch(bodies[b], moving[b], start, now);
  });
  bool deep = bodies.size() > kBits || (some.bodies & (some.bodies - 1));
  for (int sweep = 0; deep && sweep < kSweeps; ++sweep) {
    deep = false;
    each_of(some.bodies, bodies.size(), [&](std::size_t b) { deep |= leave(moving[b], now.x); });
  }
  alignas(64) T to[9][n];
  const V3<T> later = now.x + damping * now.v;
  store<T>(to[0], now.x.x), store<T>(to[1], now.x.y), store<T>(to[2], now.x.z);
  store<T>(to[3], now.v.x), store<T>(to[4], now.v.y), store<T>(to[5], now.v.z);
  store<T>(to[6], later.x), store<T>(to[7], later.y), store<T>(to[8], later.z);
  for (unsigned left = some.lanes; left; left &= left - 1) {
    const int l = __builtin_ctz(left), at = some.at[l];
    for (int k = 0; k < 3; ++k) x[at + k * n] = to[k][l], v[at + k * n] = to[3 + k][l], y[at + k * n] = to[6 + k][l];
  }
}

// Contact of all vertices of fields that a step took at v to x. Few of those near bodies touch one, in vectors far from
// each other: they are found first, by the body that they may touch, and then taken together.
template <class T>
void keep_out(const Strips<T>& s, const StepTerms<T>& p, const std::vector<BodyLanes<T>>& bodies,
              const std::vector<Near>& near, T* x, T* v, T* y) {
  constexpr int n = kLanes<T>;
  const V<T> dt = load(p.dt);
  const std::vector<Moving<T>>& moving = moving_bodies(bodies, p);
  thread_local std::vector<std::vector<Touching>> found;  // by body
  thread_local std::vector<Together<T>> together;
  found.resize(bodies.size()), together.clear();
  for (auto& one : found) one.clear();
  for (const Near& some : near) {
    const V3<T> at = get<T>(x + some.at), way = dt * get<T>(v + some.at);
    unsigned left = some.lanes;
    each_of(some.bodies, bodies.size(), [&](std::size_t b) {
      const auto touches = may_touch(moving[b], at, way);
      if (!any<T>(touches)) return;
      unsigned lanes = bits<T>(touches) & left;
      left &= ~lanes;
      for (; lanes; lanes &= lanes - 1) found[b].push_back({some.at + __builtin_ctz(lanes), some.bodies});
    });
  }
  int filled[n] = {};  // vectors that each lane is full in
  for (const auto& of_body : found)
    for (const Touching& one : of_body) {
      const int own = one.at % n, lane = s.banded ? 0 : own;
      const std::size_t number = std::size_t(s.banded ? filled[0]++ / n : filled[lane]++);
      if (number == together.size()) together.emplace_back();
      together[number].add(one, s.banded ? (filled[0] - 1) % n : own);
    }
  for (const Together<T>& some : together) touch_together(some, bodies, moving, p, x, v, y);
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
