// Contact with bodies, in vectors. Compiled once per instruction set, as simd.hpp.
#pragma once
#include "../base/simd.hpp"
#include "bodies.hpp"

namespace minicloth {
namespace LANES {
namespace {

// A point that is the same in all lanes, or each lane's own.
template <class T>
inline V3<T> point(const T (&p)[3]) {
  const V<T> none = {};
  return {none + p[0], none + p[1], none + p[2]};
}
template <class T>
inline V3<T> point(const T (&p)[3][kMostLanes<T>]) {
  return {load(p[0]), load(p[1]), load(p[2])};
}

// nearest and axis_point of bodies.hpp.
template <class T, class Ends>
inline V<T> nearest(const Ends& ends, const V3<T>& q) {
  const V3<T> from = point(ends[0]), axis = point(ends[1]) - from;
  const V<T> none = {}, t = dot(q - from, axis) / (dot(axis, axis) + tiny<T>);
  return t < T(0) ? none : (t > T(1) ? none + T(1) : t);
}
template <class T, class Ends>
inline V3<T> axis_point(const Ends& ends, const V<T>& t) {
  const V3<T> from = point(ends[0]);
  return from + t * (point(ends[1]) - from);
}

// What holds a vertex out of a body: the normal and the distance to go along it, in the lanes that touch.
template <class T, class Mask>
inline void hold_out(const V3<T>& n, const V<T>& gap, const Mask& touching, const V3<T>& body, T friction,
                     const V<T>& dt, V3<T>& x, V3<T>& v) {
  const V<T> none = {}, one = none + T(1);
  const V3<T> u = v - body;
  const V<T> un = dot(u, n), stop = (touching & (un < T(0))) ? -un : none;  // normal change of velocity
  const V3<T> slide = u - un * n;
  const V<T> held = friction * stop * rsqrt(dot(slide, slide) + tiny<T>);
  const V<T> hold = held < T(1) ? held : one;
  const V<T> push = touching ? -gap : none, back = dt * hold;
  v = v + (stop * n - hold * slide);
  x = x + (push * n - back * slide);
}

// Swept contact with Coulomb friction. In the body's frame a vertex goes from p0 to p1; where it would
// enter, the tangent plane at the entry point holds it, at the speed of the body. Friction takes up to
// mu times the normal change of velocity from the sliding speed.
template <class T>
inline void touch_plane(const BodyLanes<T>& b, const V<T>& dt, V3<T>& x, V3<T>& v) {
  const V3<T> on = point(b.after[0]), n = point(b.after[1]);
  const V<T> gap = dot(n, x - on) - b.radius;
  const auto touching = gap < T(0);
  if (any<T>(touching)) hold_out<T>(n, gap, touching, (T(1) / dt) * (on - point(b.before[0])), b.friction, dt, x, v);
}

template <class T, bool kCapsule>
inline void touch_round(const BodyLanes<T>& b, const V<T>& dt, const V3<T>& x0, V3<T>& x1, V3<T>& v) {
  const T radius = b.radius, radius2 = radius * radius;
  const V<T> none = {}, one = none + T(1);
  V<T> t1 = none;
  V3<T> p0, p1;
  if constexpr (kCapsule) {
    t1 = nearest<T>(b.after, x1);
    p0 = x0 - axis_point<T>(b.before, nearest<T>(b.before, x0)), p1 = x1 - axis_point<T>(b.after, t1);
  } else {
    p0 = x0 - point(b.before[0]), p1 = x1 - point(b.after[0]);
  }
  const V3<T> d = p1 - p0;
  const V<T> start2 = dot(p0, p0), outside = start2 - radius2, along = dot(p0, d);
  // Entering takes outside <= sqrt(disc) - along, of which neither is more than -along.
  if (!any<T>((outside < T(0)) | (outside <= T(-2.01) * along))) return;
  const V<T> disc = along * along - dot(d, d) * outside;
  const auto inside = outside < T(0);
  const V<T> safe = disc > T(0) ? disc : none;
  const V<T> time = outside / (safe * rsqrt(safe + T(1e-30)) - along + tiny<T>);
  const auto enters = (along < T(0)) & (disc > T(0)) & (time <= T(1)) & (outside >= T(0));
  const V<T> way = enters ? time : none;
  const V<T> scale = inside ? rsqrt(start2 + tiny<T>) : one / radius;
  const V3<T> n = scale * (p0 + way * d);
  const V<T> gap = dot(n, p1) - radius;
  const auto touching = (inside | enters) & (gap < T(0));
  if (!any<T>(touching)) return;
  V3<T> moved = point(b.after[0]) - point(b.before[0]);
  if constexpr (kCapsule) moved = axis_point<T>(b.after, t1) - axis_point<T>(b.before, t1);
  hold_out<T>(n, gap, touching, (one / dt) * moved, b.friction, dt, x1, v);
}

// Vertices that a step of dt took from x0 to x1 at velocity v.
template <class T>
inline void touch(const BodyLanes<T>& b, const V<T>& dt, const V3<T>& x0, V3<T>& x1, V3<T>& v) {
  if (b.shape == Shape::kSphere) return touch_round<T, false>(b, dt, x0, x1, v);
  if (b.shape == Shape::kPlane) return touch_plane(b, dt, x1, v);
  touch_round<T, true>(b, dt, x0, x1, v);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
