// What the air does to a triangle, by its resistance (cloth_envs.physics.laws.air) and by pressure, and that on the
// four triangles of each cell that its two diagonals make, each with half its force: a mirrored cloth then feels
// mirrored air. Corners are numbered 0 upper left, 1 upper right, 2 lower right, 3 lower left; triangle k is the one
// without corner k.
#pragma once
#include "../base/geometry.hpp"
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
  T normal, lift, tangential;                 // density * coefficient / 36 [kg/m^3], for three times the velocity
  T half_pressure;                            // Pa
  T wind[3];                                  // m/s
  T slow_normal, slow_lift, slow_tangential;  // h density * coefficient / (6 areal density), per m/s; of implicit steps
};

// Of a frame; `slow` is h / (2 areal density) for slowed_air.
template <class T>
AirTerms<T> air_terms(const Sheet& sheet, const Frame<T>& f, double slow = 0) {
  return {T(sheet.air_normal / 36),
          T(sheet.air_lift / 36),
          T(sheet.air_tangential / 36),
          T(sheet.pressure ? f.pressure / 2 : 0.0),
          {T(f.wind[0]), T(f.wind[1]), T(f.wind[2])},
          T(slow * sheet.air_normal / 3),
          T(slow * sheet.air_lift / 3),
          T(slow * sheet.air_tangential / 3)};
}

#ifdef LANES
namespace LANES {
namespace {

constexpr int kChunk = 256;  // vertices whose forces are kept before they are added

// The force on a triangle, n twice its area vector, u three times its velocity through the air:
// -rho/2 A ((C_n |u_n| + C_l |u_t|) u_n n + C_t |u_t| u_t) + p A n, there with the unit normal n and u itself.
template <class T, class Terms>
__attribute__((always_inline)) inline V3<T> air_force(const V3<T>& n, const V3<T>& u, const Terms& p) {
  const V<T> square = dot(n, n) + T(1e-30), through = dot(n, u), turn = through * reciprocal(square);
  const V<T> rest = square * dot(u, u) - through * through, least = V<T>{} + T(1e-36);
  const V<T> product = rest > least ? rest : least, sliding = product * rsqrt(product);  // 2 A |3 u_t|
  const V<T> size = through < T(0) ? -through : through, drag = p.tangential * sliding;
  const V<T> push = p.half_pressure + (drag - (p.normal * size + p.lift * sliding)) * turn;
  return push * n - drag * u;
}

// The same at the end of a long step h, for what u would be without the air's force, which then leaves r u of it along
// the normal and in the plane: r |u| (1 + h c_l s) + h c_n (r |u|)^2 = |u|, the implicit step of a free triangle.
template <class T>
__attribute__((always_inline)) inline V3<T> slowed_air_force(const V3<T>& n, const V3<T>& u, const AirTerms<T>& p) {
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
  return (p.half_pressure - across * through) * n - drag * slide;
}

// Calls law(twice a triangle's area vector, three times its velocity through the air) for its force.
template <class T, class Law>
inline void facets(const Geometry<T>& g, const AirTerms<T>& p, const Planes<T>& in, const Cells<T>& out,
                   const Law& law) {
  const int s = g.stride;
  const T* cell = g.cell.data();
  const V<T> zero = {};
  const V3<T> wind3 = {zero + 3 * p.wind[0], zero + 3 * p.wind[1], zero + 3 * p.wind[2]};
  for (int i = g.begin; i < g.end; i += kLanes<T>) {
    const V3<T> x = at(in.x, i), right = at(in.x, i + 1) - x, across = at(in.x, i + s + 1) - x;
    const V3<T> down = at(in.x, i + s) - x;
    const V3<T> n1 = cross(down, across), n2 = cross(down, right), n3 = cross(across, right), n0 = (n1 + n3) - n2;
    const V<T> share = load(cell + i) / T(6);  // a third of half the force to each vertex
    // Three times a triangle's velocity is the sum less the missing corner's.
    const V3<T> sum = (at(in.v, i) + at(in.v, i + 1)) + (at(in.v, i + s) + at(in.v, i + s + 1)) - wind3;
    const auto force = [&](const V3<T>& n, int missing)
                           __attribute__((always_inline)) { return law(n, sum - at(in.v, missing)); };
    const V3<T> f0 = force(n0, i), f1 = force(n1, i + 1), f2 = force(n2, i + s + 1), f3 = force(n3, i + s);
    const V3<T> all = (f0 + f2) + (f1 + f3);
    put(out.corner[0], i, share * (all - f0));
    put(out.corner[1], i, share * (all - f1));
    put(out.corner[2], i, share * (all - f2));
    put(out.corner[3], i, share * (all - f3));
  }
}

template <class T>
void slowed_air_and_pressure(const Geometry<T>& g, const AirTerms<T>& p, const Planes<T>& in, const Cells<T>& out) {
  facets<T>(g, p, in, out,
            [&](const V3<T>& n, const V3<T>& u) __attribute__((always_inline)) { return slowed_air_force(n, u, p); });
}

// The energy whose gradient the air's force is in an implicit step:
// tau A / 4 (C_n |n.u|^3 + 3/2 C_l s |n.u|^2 + C_t |u_t|^3) / 3 for the facet of three of a cell's corners, u = their
// mean velocity less the wind and s = |u_t| as the step knows it beforehand: the law itself has no potential. `v` holds
// velocities, `air` unit normal, A / 4 and density * C_l s; the other coefficients include the density too.
inline double air_energy(const double* v, double* g, std::size_t size, int begin, int end, const int* corners,
                         const double* air, double normal, double tangential, double w0, double w1, double w2) {
  double f[3][kChunk], energy = 0;
  const double *n0 = air, *n1 = air + size, *n2 = air + 2 * size, *area = air + 3 * size, *lift = air + 4 * size;
  const int p = corners[0], q = corners[1], r = corners[2];
  const double *v0 = v, *v1 = v + size, *v2 = v + 2 * size;
  for (int first = begin; first < end; first += kChunk) {
    const int count = std::min(kChunk, end - first);
    for (int c = 0; c < count; ++c) {
      const int i = first + c;
      const double a = (v0[i + p] + v0[i + q] + v0[i + r]) / 3 - w0, b = (v1[i + p] + v1[i + q] + v1[i + r]) / 3 - w1,
                   d = (v2[i + p] + v2[i + q] + v2[i + r]) / 3 - w2;
      const double through = n0[i] * a + n1[i] * b + n2[i] * d;
      const double s0 = a - through * n0[i], s1 = b - through * n1[i], s2 = d - through * n2[i];
      const double square = s0 * s0 + s1 * s1 + s2 * s2, slide = tangential * std::sqrt(square);
      const double rise = lift[i] * through, push = normal * std::fabs(through) * through + rise;
      energy += area[i] * ((push + rise / 2) * through + slide * square);
      f[0][c] = area[i] * (push * n0[i] + slide * s0) / 3;
      f[1][c] = area[i] * (push * n1[i] + slide * s1) / 3;
      f[2][c] = area[i] * (push * n2[i] + slide * s2) / 3;
    }
    for (int k = 0; k < 3; ++k)
      for (int axis = 0; axis < 3; ++axis) {
        double* at = g + axis * size + first + corners[k];
        for (int c = 0; c < count; ++c) at[c] += f[axis][c];
      }
  }
  return energy / 3;
}

}  // namespace
}  // namespace LANES
#endif
}  // namespace minicloth
