#include "implicit.hpp"

#include <algorithm>
#include <cmath>

#ifdef MINICLOTH_X86_LEVELS
#define EVERY_SET __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EVERY_SET
#endif

namespace minicloth {
namespace {

constexpr int kChunk = 256;
constexpr double kTiny = 1e-40;  // keeps ghosts, which all lie at the origin, finite

// Springs from i to i + offset: k (|d| - L)^2 / 2 + b |d|^2 / 2. Adds to g, returns the energy.
EVERY_SET double springs(const double* x, double* g, std::size_t size, int begin, int end, int offset, const double* k,
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
EVERY_SET double linear(const double* x, double* g, std::size_t size, int begin, int end, int offset,
                        const double* bend) {
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

// tau A / 4 (C_n |n.u|^3 + C_t |u_t|^3) / 3 for the facet of three of a cell's corners, u = their mean velocity
// less the wind. `v` holds velocities; the coefficients include the air's density.
EVERY_SET double facets(const double* v, double* g, std::size_t size, int begin, int end, const int* corners,
                        const double* air, double normal, double tangential, double w0, double w1, double w2) {
  double f[3][kChunk], energy = 0;
  const double *n0 = air, *n1 = air + size, *n2 = air + 2 * size, *area = air + 3 * size;
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
      const double push = normal * std::fabs(through) * through;
      energy += area[i] * (push * through + slide * square);
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

Potential::Potential(int rows, int cols, double row_length, double col_length, bool periodic)
    : geometry_(rows, cols, row_length, col_length, periodic) {
  const Geometry<double>& g = geometry_;
  const auto add = [&](int offset, double length, const Plane<double>& weight, const Plane<double>* near) {
    const Plane<double> none(g.size, 0.0);
    springs_.push_back({offset, length, &weight, near, none, none, none});
  };
  add(1, g.col_length, g.along, &g.along_near);
  add(g.stride, g.row_length, g.down, &g.down_near);
  add(g.stride + 1, g.diagonal, g.right, nullptr);
  add(g.stride - 1, g.diagonal, g.left, nullptr);
  for (auto [offset, weight] : {std::pair{2, &g.along_far}, std::pair{2 * g.stride, &g.down_far}})
    far_.push_back({offset, weight, Plane<double>(g.size, 0.0)});
  for (auto* plane : {&x_, &g_, &base_, &along_, &v_}) plane->assign(3 * g.size, 0.0);
  air_.assign(16 * g.size, 0.0);
  mass_.resize(vertices()), target_.resize(3 * vertices());
}

void Potential::pad(const double* from, Plane<double>& to) const {
  const Geometry<double>& g = geometry_;
  for (int axis = 0; axis < 3; ++axis)
    for (int r = 0; r < g.rows; ++r) {
      double* row = to.data() + axis * g.size + g.at(r, 0);
      std::copy_n(from + axis * vertices() + r * g.cols, g.cols, row);
      for (int k = 1; g.periodic && k <= kGhost; ++k) row[-k] = row[g.cols - k], row[g.cols + k - 1] = row[k - 1];
    }
}

void Potential::begin(const Stage& s) {
  const Geometry<double>& g = geometry_;
  const int n = vertices();
  pad(s.base, base_), pad(s.along, along_);
  tau_ = s.tau;
  const double ratio = s.sheet.damping / s.tau;
  const auto each = [&](auto body) {
    for (int r = 0; r < g.rows; ++r)
      for (int c = 0; c < g.cols; ++c) body(g.at(r, c), r * g.cols + c);
  };
  for (Springs& e : springs_) {
    const double modulus = e.linear ? s.sheet.stretch : s.sheet.shear;
    each([&](int i, int) {
      double square = kTiny, before = 0;
      for (int axis = 0; axis < 3; ++axis) {
        const std::size_t at = axis * g.size + i;
        const double d = along_[at + e.offset] - along_[at];
        square += d * d, before += d * (base_[at + e.offset] - base_[at]);
      }
      e.stiffness[i] = modulus * (*e.weight)[i] * (1 + ratio);
      e.rest[i] = (e.length + ratio * before / std::sqrt(square)) / (1 + ratio);
      e.bend[i] = e.linear ? s.sheet.bend * (*e.linear)[i] : 0.0;
    });
  }
  for (Far& e : far_) each([&](int i, int) { e.bend[i] = s.sheet.bend * (*e.weight)[i]; });

  // The facets as in lanes.cpp: number k is the one without corner k.
  normal_ = s.wind_normal, tangential_ = s.wind_tangential, wind_ = normal_ > 0 || tangential_ > 0;
  std::copy_n(s.wind, 3, wind_velocity_);
  std::fill(g_.begin(), g_.end(), 0.0);  // the pressure's force for now
  const int corner[4] = {0, 1, g.stride + 1, g.stride};
  if (wind_ || s.pressure != 0)
    each([&](int i, int) {
      if (g.cell[i] == 0) return;
      for (int k = 0; k < 4; ++k) {
        const int p = corner[(k + 1) % 4], q = corner[(k + 2) % 4], r = corner[(k + 3) % 4];
        double a[3], b[3];
        for (int axis = 0; axis < 3; ++axis) {
          const double* x = along_.data() + axis * g.size + i;
          a[axis] = x[r] - x[p], b[axis] = x[q] - x[p];
        }
        const double cross[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
        const double twice = std::sqrt(cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2] + kTiny);
        for (int axis = 0; axis < 3; ++axis) {
          air_[(4 * k + axis) * g.size + i] = cross[axis] / twice;
          for (int at : {p, q, r}) g_[axis * g.size + i + at] += s.pressure * cross[axis] / 12;
        }
        air_[(4 * k + 3) * g.size + i] = twice / 8;
      }
    });
  each([&](int i, int v) {
    const double area = 1 / g.inverse_area[i];
    mass_[v] = s.sheet.density * area * s.inertia;
  });
  if (s.pressure != 0) {
    fold();
    each([&](int i, int v) {
      for (int axis = 0; axis < 3; ++axis) s.target[axis * n + v] += g_[axis * g.size + i] / mass_[v];
    });
  }
  std::copy_n(s.target, 3 * n, target_.data());
}

// Adds what fell on the ghost columns of a tube to the columns that they stand for.
void Potential::fold() {
  const Geometry<double>& g = geometry_;
  if (!g.periodic) return;
  for (int axis = 0; axis < 3; ++axis)
    for (int r = 0; r < g.rows; ++r) {
      double* row = g_.data() + axis * g.size + g.at(r, 0);
      for (int k = 1; k <= kGhost; ++k) {
        row[g.cols - k] += row[-k], row[k - 1] += row[g.cols + k - 1];
        row[-k] = row[g.cols + k - 1] = 0;
      }
    }
}

double Potential::evaluate(const double* x, double* gradient) {
  const Geometry<double>& g = geometry_;
  const int n = vertices();
  pad(x, x_);
  std::fill(g_.begin(), g_.end(), 0.0);
  double energy = 0;
  for (const Springs& e : springs_)
    energy += springs(x_.data(), g_.data(), g.size, g.begin, g.end, e.offset, e.stiffness.data(), e.rest.data(),
                      e.bend.data());
  for (const Far& e : far_) energy += linear(x_.data(), g_.data(), g.size, g.begin, g.end, e.offset, e.bend.data());
  if (wind_) {
    for (std::size_t i = 0; i < 3 * g.size; ++i) v_[i] = (x_[i] - base_[i]) / tau_;
    const int corner[4] = {0, 1, g.stride + 1, g.stride};
    for (int k = 0; k < 4; ++k) {
      const int three[3] = {corner[(k + 1) % 4], corner[(k + 2) % 4], corner[(k + 3) % 4]};
      energy += tau_ * facets(v_.data(), g_.data(), g.size, g.begin, g.end, three, air_.data() + 4 * k * g.size,
                              normal_, tangential_, wind_velocity_[0], wind_velocity_[1], wind_velocity_[2]);
    }
  }
  fold();
  double inertia = 0;
  for (int axis = 0; axis < 3; ++axis)
    for (int r = 0; r < g.rows; ++r)
      for (int c = 0, v = r * g.cols; c < g.cols; ++c, ++v) {
        const double d = x[axis * n + v] - target_[axis * n + v], pull = mass_[v] * d;
        gradient[axis * n + v] = g_[axis * g.size + g.at(r, c)] + pull;
        inertia += pull * d;
      }
  return energy + inertia / 2;
}

}  // namespace minicloth
