// The air's and pressure's force on one cell, corners numbered as in air.hpp.
#pragma once
#ifdef LANES
#include "../base/simd.hpp"
#endif

namespace minicloth {

constexpr double kOwn = 1.0 / 9;  // how much of it counts what a corner is faster than its cell

#ifdef LANES
namespace LANES {
namespace {

// The force on each corner of a cell: `to` less `over` times its velocity.
template <class T>
struct Blown {
  V3<T> to;
  V<T> over;
};

// n is twice the cell's area vector, `sum` four times its mean velocity, `wind` four times the wind's. A quarter of
// -rho/2 A ((C_n |u_n| + C_l |u_t|) u_n n + C_t |u_t| u_t), there with the unit normal n and u itself; and kOwn times
// as much as along the normal for what the corner is faster than the mean.
template <class T, class Terms>
__attribute__((always_inline)) inline Blown<T> air_force(const V3<T>& n, const V3<T>& sum, const V3<T>& wind,
                                                         const Terms& p) {
  const V3<T> u = sum - wind;
  const V<T> square = dot(n, n) + T(1e-30), through = dot(n, u), turn = through * reciprocal(square);
  const V<T> rest = square * dot(u, u) - through * through, least = V<T>{} + T(1e-36);
  const V<T> product = rest > least ? rest : least, sliding = product * rsqrt(product);  // 2 A |4 u_t|
  const V<T> size = through < T(0) ? -through : through, drag = p.tangential * sliding;
  const V<T> across = p.normal * size + p.lift * sliding, own = T(kOwn) * across;
  return {((drag - across) * turn) * n - drag * u + own * sum, T(4) * own};
}

// Pressure's force on the corners of a cell, without the pressure / 12: twice the area of the triangles at each. The
// corners' positions are relative to the upper left one.
template <class T>
struct Pressed {
  V3<T> corner[4];
  Pressed(const V3<T>& right, const V3<T>& across, const V3<T>& down, const V3<T>& n) {
    const V3<T> n1 = cross(down, across), n2 = cross(down, right), all = n + n;
    corner[0] = n + n2, corner[1] = all - n1, corner[2] = all - n2, corner[3] = n + n1;
  }
};

}  // namespace
}  // namespace LANES
#endif
}  // namespace minicloth
