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

// Of a vertex and an edge from a along e.
template <class T>
inline V<T> to_edge(const V3<T>& p, const V3<T>& e) {
  const V3<T> d = p - clamp01<T>(dot(p, e) / (dot(e, e) + tiny<T>)) * e;
  return dot(d, d);
}

// Of a vertex and a triangle (Ericson 2005, section 5.1.5).
template <class T>
inline V<T> to_triangle(const V3<T>& p, const V3<T>& a, const V3<T>& b, const V3<T>& c) {
  const V3<T> e = b - a, f = c - a, q = p - a, n = cross(e, f);
  const V<T> n2 = dot(n, n) + tiny<T>, height = dot(q, n);
  const V<T> u = dot(cross(q, f), n), v = dot(cross(e, q), n);
  const V<T> none = {}, plane = height * height / n2;
  const V<T> d0 = to_edge<T>(q, e), d1 = to_edge<T>(q, f), d2 = to_edge<T>(p - b, c - b);
  const V<T> d01 = d0 < d1 ? d0 : d1, border = d01 < d2 ? d01 : d2;
  return ((u >= none) & (v >= none) & (u + v <= n2)) ? plane : border;
}

// Of two edges from p along d and from q along e (section 5.1.9).
template <class T>
inline V<T> of_edges(const V3<T>& p, const V3<T>& d, const V3<T>& q, const V3<T>& e) {
  const V3<T> r = p - q;
  const V<T> a = dot(d, d) + tiny<T>, b = dot(d, e), c = dot(d, r), g = dot(e, e) + tiny<T>, f = dot(e, r);
  const V<T> denominator = a * g - b * b;
  const V<T> s0 = clamp01<T>((b * f - c * g) / (denominator + T(1e-6) * a * g));
  const V<T> t = clamp01<T>((b * s0 + f) / g), s = clamp01<T>((b * t - c) / a);
  const V3<T> w = r + (s * d - t * e);
  return dot(w, w);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
