// Points on the axes of bodies, in vectors. Compiled once per instruction set, as simd.hpp.
#pragma once
#include "simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

// How far along a body's axis, from 0 to 1, the point nearest to q lies; and that point.
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

}  // namespace
}  // namespace LANES
}  // namespace minicloth
