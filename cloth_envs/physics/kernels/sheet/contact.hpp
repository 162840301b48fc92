// Contact with bodies, in vectors. Compiled once per instruction set, as simd.hpp.
#pragma once
#include "../base/geometry.hpp"
#include "../base/simd.hpp"
#include "bodies.hpp"

namespace minicloth {
namespace LANES {
namespace {

// nearest and axis_point of bodies.hpp.
template <class T>
inline V<T> nearest(const T (&ends)[2][3], const V3<T>& q) {
  const T a[3] = {ends[1][0] - ends[0][0], ends[1][1] - ends[0][1], ends[1][2] - ends[0][2]};
  const T length2 = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
  if (length2 == 0) return V<T>{};
  const V<T> t = ((q.x - ends[0][0]) * a[0] + (q.y - ends[0][1]) * a[1] + (q.z - ends[0][2]) * a[2]) / length2;
  return t < T(0) ? V<T>{} : (t > T(1) ? V<T>{} + T(1) : t);
}
template <class T>
inline V3<T> axis_point(const T (&ends)[2][3], const V<T>& t) {
  return {ends[0][0] + t * (ends[1][0] - ends[0][0]), ends[0][1] + t * (ends[1][1] - ends[0][1]),
          ends[0][2] + t * (ends[1][2] - ends[0][2])};
}

// Swept contact with Coulomb friction. In the body's frame a vertex goes from p0 to p1; where it would
// enter, the tangent plane at the entry point holds it, at the speed of the body. Friction takes up to
// mu times the normal change of velocity from the sliding speed.
enum Shape { kSphere, kCapsule, kPlane };
template <class T, Shape kShape>
void contact_with(const Geometry<T>& g, const BodyStep<T>& b, const Planes<T>& in, const Planes<T>& out) {
  const T radius = b.radius, radius2 = radius * radius, rate = T(1) / b.dt, dt = b.dt, friction = b.friction;
  const V<T> zero = {}, one = zero + T(1);
  const T slope[3] = {(b.after[0][0] - b.before[0][0]) * rate, (b.after[0][1] - b.before[0][1]) * rate,
                      (b.after[0][2] - b.before[0][2]) * rate};
  for (int i = g.begin; i < g.end; i += kLanes<T>) {
    const V3<T> x1 = at(out.x, i);
    V3<T> n, body = {zero + slope[0], zero + slope[1], zero + slope[2]};
    V<T> gap;
    auto touching = zero < zero;
    if constexpr (kShape == kPlane) {
      n = {zero + b.after[1][0], zero + b.after[1][1], zero + b.after[1][2]};
      const V3<T> point = {zero + b.after[0][0], zero + b.after[0][1], zero + b.after[0][2]};
      gap = dot(n, x1 - point) - radius;
      touching = gap < T(0);
      if (!any<T>(touching)) continue;
    } else {
      const V3<T> x0 = at(in.x, i);
      V<T> t1 = zero;
      V3<T> p0, p1;
      if constexpr (kShape == kSphere) {
        p0 = {x0.x - b.before[0][0], x0.y - b.before[0][1], x0.z - b.before[0][2]};
        p1 = {x1.x - b.after[0][0], x1.y - b.after[0][1], x1.z - b.after[0][2]};
      } else {
        t1 = nearest(b.after, x1);
        p0 = x0 - axis_point(b.before, nearest(b.before, x0)), p1 = x1 - axis_point(b.after, t1);
      }
      const V3<T> d = p1 - p0;
      const V<T> start2 = dot(p0, p0), outside = start2 - radius2, along = dot(p0, d);
      // Entering takes outside <= sqrt(disc) - along, of which neither is more than -along.
      if (!any<T>((outside < T(0)) | (outside <= T(-2.01) * along))) continue;
      const V<T> disc = along * along - dot(d, d) * outside;
      const auto inside = outside < T(0);
      const V<T> safe = disc > T(0) ? disc : zero;
      const V<T> time = outside / (safe * rsqrt(safe + T(1e-30)) - along + tiny<T>);
      const auto enters = (along < T(0)) & (disc > T(0)) & (time <= T(1)) & (outside >= T(0));
      const V<T> way = enters ? time : zero;
      const V<T> scale = inside ? rsqrt(start2 + tiny<T>) : one / radius;
      n = scale * (p0 + way * d);
      gap = dot(n, p1) - radius;
      touching = (inside | enters) & (gap < T(0));
      if (!any<T>(touching)) continue;
      if constexpr (kShape == kCapsule) {
        const V<T> r = zero + rate;
        body = r * (axis_point(b.after, t1) - axis_point(b.before, t1));
      }
    }
    const V3<T> v = at(out.v, i), u = v - body;
    const V<T> un = dot(u, n);
    const V<T> stop = (touching & (un < T(0))) ? -un : zero;  // normal change of velocity
    const V3<T> slide = u - un * n;
    const V<T> held = friction * stop * rsqrt(dot(slide, slide) + tiny<T>);
    const V<T> hold = held < T(1) ? held : one;
    const V<T> push = touching ? -gap : zero, back = dt * hold;
    put(out.v, i, v + (stop * n - hold * slide));
    put(out.x, i, x1 + (push * n - back * slide));
  }
}

template <class T>
void contact(const Geometry<T>& g, const BodyStep<T>& b, const Planes<T>& in, const Planes<T>& out) {
  const auto point = [](const T(&ends)[2][3]) {
    return ends[0][0] == ends[1][0] && ends[0][1] == ends[1][1] && ends[0][2] == ends[1][2];
  };
  if (b.plane) return contact_with<T, kPlane>(g, b, in, out);
  if (point(b.before) && point(b.after)) return contact_with<T, kSphere>(g, b, in, out);
  contact_with<T, kCapsule>(g, b, in, out);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
