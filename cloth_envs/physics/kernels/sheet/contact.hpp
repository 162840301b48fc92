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
template <class T, int width>
inline V3<T> point(const T (&p)[3][width]) {
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

// A body in one step of dt: what all vertices share.
template <class T>
struct Moving {
  Shape shape;
  V3<T> before, after, moved;  // its first end or its point, and how far that moves
  V3<T> axis, other;           // to the other end, or the normal; and how far the other end moves
  V3<T> turn;                  // about the axis [rad]
  V<T> radius, radius2, over_radius, over_axis2, far, dt, rate, friction;
  template <int width>
  Moving(const BodyLanes<T, width>& b, const V<T>& dt_)
      : shape(b.shape),
        before(point(b.before[0])),
        after(point(b.after[0])),
        moved(after - before),
        axis(shape == Shape::kPlane ? point(b.after[1]) : point(b.after[1]) - after),
        other(point(b.after[1]) - point(b.before[1])),
        turn(point(b.turn)),
        radius(V<T>{} + b.radius),
        radius2(radius * radius),
        over_radius(T(1) / radius),
        over_axis2(T(1) / (dot(axis, axis) + tiny<T>)),
        far(dot(moved, moved) + dot(other, other)),
        dt(dt_),
        rate(T(1) / dt_),
        friction(V<T>{} + b.friction) {}
};

// From positions to the nearest point of a round body's axis.
template <class T>
inline V3<T> off_axis(const Moving<T>& m, const V3<T>& x) {
  const V3<T> p = x - m.after;
  if (m.shape == Shape::kSphere) return p;
  const V<T> none = {}, along = dot(p, m.axis) * m.over_axis2;
  return p - (along < T(0) ? none : (along > T(1) ? none + T(1) : along)) * m.axis;
}

// The squared distance from there, or from the plane where that is positive.
template <class T>
inline V<T> distance2(const Moving<T>& m, const V3<T>& x) {
  const V<T> none = {};
  if (m.shape != Shape::kPlane) {
    const V3<T> off = off_axis(m, x);
    return dot(off, off);
  }
  const V<T> gap = dot(m.axis, x - m.after);
  return gap < T(0) ? none : gap * gap;
}

// Where vertices that a step took by `way` to x may touch; some that do not pass.
template <class T>
inline auto may_touch(const Moving<T>& m, const V3<T>& x, const V3<T>& way) {
  const V3<T> p = x - m.after;
  if (m.shape == Shape::kPlane) return dot(m.axis, p) < m.radius;
  // In the body's frame one goes by d to p. To enter it, or to be held in the tangent plane where it was inside, takes
  // |p - d|^2 - R^2 <= -2 (p - d) . d, that is |p|^2 <= R^2 + |d|^2.
  if (m.shape == Shape::kSphere) {
    const V3<T> d = way - m.moved;
    return dot(p, p) < m.radius2 + T(1.01) * dot(d, d);
  }
  // p and p - d are from the nearest points of a capsule's axis, which go no further than vertex and ends together.
  const V3<T> off = off_axis(m, x);
  return dot(off, off) < m.radius2 + T(8.1) * (dot(way, way) + m.far);
}

// Positions that are deep inside a body, put onto its surface; whether any was.
template <class T>
inline bool leave(const Moving<T>& m, V3<T>& x) {
  const V<T> none = {};
  V3<T> off = m.axis;
  V<T> push;
  if (m.shape == Shape::kPlane) {
    const V<T> gap = dot(m.axis, x - m.after) - m.radius;
    push = gap < -T(kDeep) ? -gap : none;
  } else {
    off = off_axis(m, x);
    const V<T> square = dot(off, off), most = m.radius - T(kDeep);
    const auto deep = (most > none) & (square < most * most);
    push = deep ? m.radius * rsqrt(square + tiny<T>) - T(1) : none;
  }
  x = x + push * off;
  return any<T>(push > none);
}

// Swept contact with Coulomb friction of vertices that the step took from x0 to x at velocity v. In the body's frame
// one goes from p0 to p1; where it would enter, the tangent plane at the entry point holds it, at the speed of the
// body. Friction takes up to mu times the normal change of velocity from the sliding speed.
template <class T, Shape kShape, int width>
inline void touch_shape(const BodyLanes<T, width>& b, const Moving<T>& m, const V3<T>& x0, V3<T>& x, V3<T>& v) {
  const V<T> none = {}, one = none + T(1);
  V3<T> n, body = m.moved;
  V<T> gap;
  auto touching = none < none;
  if constexpr (kShape == Shape::kPlane) {
    n = m.axis, gap = dot(n, x - m.after) - m.radius, touching = gap < T(0);
  } else {
    V3<T> p0 = x0 - m.before, p1 = x - m.after;
    if constexpr (kShape == Shape::kCapsule) {
      const V<T> t1 = nearest<T>(b.after, x);
      p0 = x0 - axis_point<T>(b.before, nearest<T>(b.before, x0)), p1 = x - axis_point<T>(b.after, t1);
      body = body + t1 * (m.other - m.moved);
    }
    const V3<T> d = p1 - p0;
    const V<T> start2 = dot(p0, p0), outside = start2 - m.radius2, along = dot(p0, d);
    const V<T> disc = along * along - dot(d, d) * outside, safe = disc > T(0) ? disc : none;
    const V<T> time = outside / (safe * rsqrt(safe + T(1e-30)) - along + tiny<T>);
    const auto inside = outside < T(0);
    const auto enters = (along < T(0)) & (disc > T(0)) & (time <= T(1)) & (outside >= T(0));
    const V<T> way = enters ? time : none, scale = inside ? rsqrt(start2 + tiny<T>) : m.over_radius;
    n = scale * (p0 + way * d), gap = dot(n, p1) - m.radius, touching = (inside | enters) & (gap < T(0));
  }
  if constexpr (kShape == Shape::kCapsule) body = body + m.radius * cross(m.turn, n);
  const V3<T> u = v - m.rate * body;
  const V<T> un = dot(u, n), stop = (touching & (un < T(0))) ? -un : none;  // normal change of velocity
  const V3<T> slide = u - un * n;
  const V<T> held = m.friction * stop * rsqrt(dot(slide, slide) + tiny<T>), hold = held < T(1) ? held : one;
  const V<T> push = touching ? -gap : none, back = m.dt * hold;
  v = v + (stop * n - hold * slide);
  x = x + (push * n - back * slide);
  if constexpr (kShape == Shape::kCapsule) {  // the tangent plane did not turn with it
    const V3<T> p = x - axis_point<T>(b.after, nearest<T>(b.after, x));
    const V<T> p2 = dot(p, p), out = p2 < m.radius2 ? m.radius * rsqrt(p2 + tiny<T>) - one : none;
    x = x + out * p;
  }
}

template <class T>
struct Vertex {
  V3<T> x, v;
};
template <class T, int width>
__attribute__((always_inline)) inline Vertex<T> touch(const BodyLanes<T, width>& b, const Moving<T>& m, const V3<T>& x0,
                                                      Vertex<T> at) {
  if (m.shape == Shape::kSphere) touch_shape<T, Shape::kSphere>(b, m, x0, at.x, at.v);
  if (m.shape == Shape::kPlane) touch_shape<T, Shape::kPlane>(b, m, x0, at.x, at.v);
  if (m.shape == Shape::kCapsule) touch_shape<T, Shape::kCapsule>(b, m, x0, at.x, at.v);
  return at;
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
