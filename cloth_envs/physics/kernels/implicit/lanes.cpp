// Compiled once per instruction set; LANES names the namespace. Sums are taken in any order, so that they vectorise.
#include <algorithm>
#include <cmath>

#include "../sheet/air.hpp"
#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

constexpr double kTiny = 1e-40;  // keeps ghosts, which all lie at the origin, finite

// Springs from i to i + offset: k (|d| - L)^2 / 2 + b |d|^2 / 2. Adds to g, returns the energy.
double springs(const double* x, double* g, std::size_t size, int begin, int end, int offset, const double* k,
               const double* rest, const double* bend) {
  const double *x0 = x, *x1 = x + size, *x2 = x + 2 * size;
  double f[3][kChunk], energy = 0;
  for (int first = begin; first < end; first += kChunk) {
    const int count = std::min(kChunk, end - first);
    for (int c = 0; c < count; ++c) {
      const int i = first + c, j = i + offset;
      const double a = x0[j] - x0[i], b = x1[j] - x1[i], d = x2[j] - x2[i];
      const double square = a * a + b * b + d * d + kTiny, length = std::sqrt(square), longer = length - rest[i];
      energy += k[i] * longer * longer + bend[i] * square;
      const double pull = k[i] * longer / length + bend[i];
      f[0][c] = pull * a, f[1][c] = pull * b, f[2][c] = pull * d;
    }
    for (int axis = 0; axis < 3; ++axis) {
      double *at = g + axis * size + first, *to = at + offset;
      for (int c = 0; c < count; ++c) at[c] -= f[axis][c];
      for (int c = 0; c < count; ++c) to[c] += f[axis][c];
    }
  }
  return energy / 2;
}

// b |x_j - x_i|^2 / 2, with j = i + offset.
double linear(const double* x, double* g, std::size_t size, int begin, int end, int offset, const double* bend) {
  double f[kChunk], energy = 0;
  for (int axis = 0; axis < 3; ++axis)
    for (int first = begin; first < end; first += kChunk) {
      const int count = std::min(kChunk, end - first);
      const double *from = x + axis * size + first, *weight = bend + first;
      for (int c = 0; c < count; ++c) {
        const double d = from[c + offset] - from[c];
        f[c] = weight[c] * d;
        energy += f[c] * d;
      }
      double *at = g + axis * size + first, *to = at + offset;
      for (int c = 0; c < count; ++c) at[c] -= f[c];
      for (int c = 0; c < count; ++c) to[c] += f[c];
    }
  return energy / 2;
}

const ImplicitLanes instance = {springs, linear, air_energy};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ImplicitLanes, instance)

}  // namespace minicloth
