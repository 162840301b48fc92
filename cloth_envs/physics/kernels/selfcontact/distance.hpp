// Squared distances, in all lanes at once. Included where it is compiled for an instruction set.
#pragma once
#include "../base/simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
inline V<T> clamp01(const V<T>& t) {
  const V<T> none = {}, one = none + T(1);
  return t < none ? none : (t > one ? one : t);
}

// Shares of two points that lie nearest to each other, and what they are of: a vertex (1) and corners a, b, c of a
// triangle, or ends a, b of an edge and c, d of another. The distance is sum share_i x_i.
template <class T>
struct Nearest {
  V<T> share[4];
};

// Of a vertex and a triangle (Ericson 2005, section 5.1.5).
template <class T>
inline Nearest<T> of_triangle(const V3<T>& p, const V3<T>& a, const V3<T>& b, const V3<T>& c) {
  const V<T> none = {}, one = none + T(1);
  const V3<T> e = b - a, f = c - a, g = c - b, q = p - a, n = cross(e, f);
  const V<T> ee = dot(e, e) + tiny<T>, ff = dot(f, f) + tiny<T>, gg = dot(g, g) + tiny<T>;
  const V<T> qe = dot(q, e), qf = dot(q, f), over = reciprocal(dot(n, n) + tiny<T>);
  const V<T> u = over * dot(cross(q, f), n), v = over * dot(cross(e, q), n);
  // Of each edge the nearest point, and how much the square of its distance is less than that of a corner.
  const V<T> s0 = clamp01<T>(qe * reciprocal(ee)), s1 = clamp01<T>(qf * reciprocal(ff));
  const V<T> s2 = clamp01<T>(dot(p - b, g) * reciprocal(gg));
  const V3<T> d0 = q - s0 * e, d1 = q - s1 * f, d2 = (p - b) - s2 * g;
  const V<T> l0 = dot(d0, d0), l1 = dot(d1, d1), l2 = dot(d2, d2);
  const auto inside = (u >= none) & (v >= none) & (u + v <= one), first = (l0 <= l1) & (l0 <= l2), second = l1 <= l2;
  const V<T> bs = inside ? u : (first ? s0 : (second ? none : one - s2));
  const V<T> cs = inside ? v : (first ? none : (second ? s1 : s2));
  return {{one, bs + cs - T(1), -bs, -cs}};
}

// Of two edges from a to b and from c to d (section 5.1.9).
template <class T>
inline Nearest<T> of_edges(const V3<T>& p, const V3<T>& p1, const V3<T>& q, const V3<T>& q1) {
  const V3<T> d = p1 - p, e = q1 - q, r = p - q;
  const V<T> a = dot(d, d) + tiny<T>, b = dot(d, e), c = dot(d, r), g = dot(e, e) + tiny<T>, f = dot(e, r);
  const V<T> s0 = clamp01<T>((b * f - c * g) * reciprocal(a * g - b * b + T(1e-6) * a * g));
  const V<T> t = clamp01<T>((b * s0 + f) * reciprocal(g)), s = clamp01<T>((b * t - c) * reciprocal(a));
  return {{T(1) - s, s, t - T(1), -t}};
}

template <class T>
inline V3<T> apart(const Nearest<T>& n, const V3<T>& a, const V3<T>& b, const V3<T>& c, const V3<T>& d) {
  return (n.share[0] * a + n.share[1] * b) + (n.share[2] * c + n.share[3] * d);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
