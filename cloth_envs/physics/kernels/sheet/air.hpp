// What the air does to a cell (cloth_envs.physics.laws.air) by its resistance; and pressure, half of it on each of the
// four triangles that the two diagonals make. A mirrored cloth feels mirrored air. Corners are numbered 0 upper left, 1
// upper right, 2 lower right, 3 lower left; triangle k is the one without corner k.
#pragma once
#include "../base/geometry.hpp"
#include "blow.hpp"
#include "sheet.hpp"
#ifdef LANES  // the loops, where they are compiled for an instruction set
#include <algorithm>
#include <cmath>

#include "../base/simd.hpp"
#endif

namespace minicloth {

template <class T>
struct Cells {  // the air's force on the four corners of the cell at its upper left vertex [N]
  T* corner[4][3];
};

template <class T>
struct AirTerms {
  T normal, lift, tangential;                 // density * coefficient / 256 [kg/m^3], for four times the velocity
  T pressure;                                 // / 12 [Pa], for twice the area and a third of half of a triangle
  T wind[3];                                  // m/s
  T slow_normal, slow_lift, slow_tangential;  // h density * coefficient / (8 areal density), per m/s; of implicit steps
};

// Of a frame; `slow` is h / (2 areal density) for slowed_air.
template <class T>
AirTerms<T> air_terms(const Sheet& sheet, const Frame<T>& f, double slow = 0) {
  return {T(sheet.air_normal / 256),
          T(sheet.air_lift / 256),
          T(sheet.air_tangential / 256),
          T(sheet.pressure ? f.pressure / 12 : 0.0),
          {T(f.wind[0]), T(f.wind[1]), T(f.wind[2])},
          T(slow * sheet.air_normal / 4),
          T(slow * sheet.air_lift / 4),
          T(slow * sheet.air_tangential / 4)};
}

#ifdef LANES
namespace LANES {
namespace {

constexpr int kChunk = 256;  // vertices whose forces are kept before they are added

// The same at the end of a long step h, for what u would be without the air's force, which then leaves r u of it along
// the normal and in the plane: r |u| (1 + h c_l s) + h c_n (r |u|)^2 = |u|, the implicit step of a free cell.
template <class T>
__attribute__((always_inline)) inline Blown<T> slowed_air_force(const V3<T>& n, const V3<T>& sum, const V3<T>& wind,
                                                                const AirTerms<T>& p) {
  const V3<T> u = sum - wind;
  const V<T> one = V<T>{} + T(1);
  const V<T> square = dot(n, n) + T(1e-30), inverse = rsqrt(square), through = inverse * dot(n, u);
  const V<T> speed = through < T(0) ? -through : through;
  const V3<T> slide = u - (through * inverse) * n;
  const V<T> slide2 = dot(slide, slide) + T(1e-30), sliding = slide2 * rsqrt(slide2);
  const V<T> two = one + one, four = two + two, lifted = one + p.slow_lift * sliding;
  const V<T> under = lifted * lifted + four * p.slow_normal * speed, along = one + four * p.slow_tangential * sliding;
  const V<T> left = two / (lifted + under * rsqrt(under)), kept = two / (one + along * rsqrt(along));
  const V<T> drag = p.tangential * (square * inverse) * sliding * kept * kept;
  const V<T> across = (p.normal * speed * left + p.lift * sliding) * left;
  const V<T> own = T(kOwn) * (square * inverse) * across;
  return {own * sum - (across * through) * n - drag * slide, T(4) * own};
}

template <class T>
void slowed_air_and_pressure(const Geometry<T>& g, const AirTerms<T>& p, const Planes<T>& in, const Cells<T>& out) {
  const int s = g.stride;
  const V<T> zero = {}, pressure = zero + p.pressure;
  const V3<T> wind4 = {zero + 4 * p.wind[0], zero + 4 * p.wind[1], zero + 4 * p.wind[2]};
  for (int i = g.begin; i < g.end; i += kLanes<T>) {
    const V3<T> x = at(in.x, i), right = at(in.x, i + 1) - x, across = at(in.x, i + s + 1) - x;
    const V3<T> down = at(in.x, i + s) - x, n = cross(across, right - down);
    const V3<T> v[4] = {at(in.v, i), at(in.v, i + 1), at(in.v, i + s + 1), at(in.v, i + s)};
    const Blown<T> blown = slowed_air_force(n, (v[0] + v[2]) + (v[1] + v[3]), wind4, p);
    const Pressed<T> pressed(right, across, down, n);
    const V<T> share = load(g.cell.data() + i);
    for (int k = 0; k < 4; ++k)
      put(out.corner[k], i, share * ((blown.to - blown.over * v[k]) + pressure * pressed.corner[k]));
  }
}

// The energy whose gradient the air's force is in an implicit step:
// tau A / 2 (C_n |n.u|^3 + 3/2 C_l s |n.u|^2 + C_t |u_t|^3) / 3 for a cell of four corners, u = their mean velocity
// less the wind and s = |u_t| as the step knows it beforehand: the law itself has no potential. The same holds for the
// rate at which corners lose what they are faster than the mean. `v` holds velocities, `air` unit normal, A / 2,
// density * C_l s and that rate [kg/s]; the other coefficients include the density too.
inline double air_energy(const double* v, double* g, std::size_t size, int begin, int end, int stride,
                         const double* air, double normal, double tangential, double w0, double w1, double w2) {
  double mean[3][kChunk], f[3][kChunk], energy = 0, even = 0;
  const double *n0 = air, *n1 = air + size, *n2 = air + 2 * size, *area = air + 3 * size, *lift = air + 4 * size;
  const double* own = air + 5 * size;
  const int corners[4] = {0, 1, stride + 1, stride};
  for (int first = begin; first < end; first += kChunk) {
    const int count = std::min(kChunk, end - first);
    for (int axis = 0; axis < 3; ++axis) {
      const double *a = v + axis * size + first, *b = a + stride;
      for (int c = 0; c < count; ++c) mean[axis][c] = ((a[c] + b[c + 1]) + (a[c + 1] + b[c])) / 4;
    }
    for (int c = 0; c < count; ++c) {
      const int i = first + c;
      const double a = mean[0][c] - w0, b = mean[1][c] - w1, d = mean[2][c] - w2;
      const double through = n0[i] * a + n1[i] * b + n2[i] * d;
      const double s0 = a - through * n0[i], s1 = b - through * n1[i], s2 = d - through * n2[i];
      const double square = s0 * s0 + s1 * s1 + s2 * s2, slide = tangential * std::sqrt(square);
      const double rise = lift[i] * through, push = normal * std::fabs(through) * through + rise;
      energy += area[i] * ((push + rise / 2) * through + slide * square);
      f[0][c] = area[i] * (push * n0[i] + slide * s0) / 4;
      f[1][c] = area[i] * (push * n1[i] + slide * s1) / 4;
      f[2][c] = area[i] * (push * n2[i] + slide * s2) / 4;
    }
    for (const int corner : corners)
      for (int axis = 0; axis < 3; ++axis) {
        const double* const from = v + axis * size + first + corner;
        double* const to = g + axis * size + first + corner;
        for (int c = 0; c < count; ++c) {
          const double faster = from[c] - mean[axis][c], lost = own[first + c] * faster;
          even += lost * faster;
          to[c] += f[axis][c] + lost;
        }
      }
  }
  return energy / 3 + even / 2;
}

}  // namespace
}  // namespace LANES
#endif
}  // namespace minicloth
