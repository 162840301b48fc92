// Which triangles of two cells lie on one side of each other's planes. Included where it is compiled for an instruction
// set.
#pragma once
#include "../base/simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

constexpr double kRound = 4e-6;  // of the distance of a plane, and more than rounding may take

// Where a triangle of a cell has one of another cell wholly on one side of its plane.
template <class T>
using Mask = decltype(V<T>{} < V<T>{});
template <class T>
struct Sides {
  Mask<T> apart[2][2];  // [triangle of the cell, 0 the lower, 1 the upper][of the other]
};
// Corners are upper left, upper right, lower left, lower right.
template <class T>
inline Sides<T> sides(const V3<T> (&p)[4], const V3<T> (&q)[4]) {
  const auto least = [](const V<T>& a, const V<T>& b) { return a < b ? a : b; };
  const auto most = [](const V<T>& a, const V<T>& b) { return a > b ? a : b; };
  Sides<T> to;
  const V3<T> diagonal = p[3] - p[0], down = p[2] - p[0], right = p[1] - p[0];
  const V<T> size = most(dot(diagonal, diagonal), most(dot(down, down), dot(right, right)));
  V3<T> d[4];
  V<T> far = {};
  for (int k = 0; k < 4; ++k) d[k] = q[k] - p[0], far = most(far, dot(d[k], d[k]));
  far += tiny<T>;
  const V<T> margin = T(kRound) * size * (far * rsqrt(far));
  for (int i = 0; i < 2; ++i) {
    const V3<T> normal = i ? cross(diagonal, right) : cross(down, diagonal);
    V<T> h[4];
    for (int k = 0; k < 4; ++k) h[k] = dot(normal, d[k]);
    for (int j = 0; j < 2; ++j) {
      const V<T> low = least(least(h[0], h[3]), h[j ? 1 : 2]), high = most(most(h[0], h[3]), h[j ? 1 : 2]);
      to.apart[i][j] = (low > margin) | (high < -margin);
    }
  }
  return to;
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
