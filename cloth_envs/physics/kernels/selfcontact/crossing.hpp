// Whether two triangles cross each other, told in double.
#pragma once
#include <algorithm>

#include "../base/vec.hpp"

namespace minicloth {

// Whether the line from p to q passes inside of the triangle's edges.
inline bool inside(const Vec<double>& p, const Vec<double>& q, const Vec<double> (&t)[3]) {
  const Vec<double> way = q - p, a = t[0] - p, b = t[1] - p, c = t[2] - p;
  const double u = dot(way, cross(a, b)), v = dot(way, cross(b, c)), w = dot(way, cross(c, a));
  return (u > 0 && v > 0 && w > 0) || (u < 0 && v < 0 && w < 0);
}

// Whether an edge of t, whose corners are at signed distances d from the plane of f, crosses the inside of f.
inline bool crosses(const Vec<double> (&t)[3], const double (&d)[3], const Vec<double> (&f)[3]) {
  for (int k = 0; k < 3; ++k) {
    const int next = k == 2 ? 0 : k + 1;
    if (((d[k] < 0 && d[next] > 0) || (d[k] > 0 && d[next] < 0)) && inside(t[k], t[next], f)) return true;
  }
  return false;
}

// Signed distances of t's corners from the plane through a point with a normal, times its length; whether some lie on
// either side.
inline bool sides(const Vec<double> (&t)[3], const Vec<double>& point, const Vec<double>& normal, double (&d)[3]) {
  for (int k = 0; k < 3; ++k) d[k] = dot(normal, t[k] - point);
  return std::min({d[0], d[1], d[2]}) < 0 && std::max({d[0], d[1], d[2]}) > 0;
}

// Whether an edge of p crosses the inside of q or one of q that of p; normals of any length.
inline bool cross_each_other(const Vec<double> (&p)[3], const Vec<double>& normal_p, const Vec<double> (&q)[3],
                             const Vec<double>& normal_q) {
  double from_q[3], from_p[3];
  return sides(p, q[0], normal_q, from_q) && sides(q, p[0], normal_p, from_p) &&
         (crosses(p, from_q, q) || crosses(q, from_p, p));
}

}  // namespace minicloth
