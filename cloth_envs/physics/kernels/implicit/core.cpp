#include "core.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "../base/vec.hpp"
#include "../sheet/air.hpp"

namespace minicloth {
namespace {

constexpr double kTiny = 1e-40;  // keeps ghosts, which all lie at the origin, finite

}  // namespace

Potential::Potential(Sheet sheet)
    : sheet_(std::move(sheet)),
      geometry_(sheet_.rows, sheet_.cols, sheet_.row_length, sheet_.col_length, sheet_.periodic) {
  const Geometry<double>& g = geometry_;
  const auto add = [&](int offset, double length, const Plane<double>& weight, const Plane<double>* near,
                       double twist) {
    const Plane<double> none(g.size, 0.0);
    springs_.push_back({offset, length, &weight, near, twist, none, none, none});
  };
  add(1, g.col_length, g.along, &g.along_near, g.twist_along);
  add(g.stride, g.row_length, g.down, &g.down_near, g.twist_down);
  add(g.stride + 1, g.diagonal, g.right, nullptr, g.twist_diagonal);
  add(g.stride - 1, g.diagonal, g.left, nullptr, g.twist_diagonal);
  for (auto [offset, weight] : {std::pair{2, &g.along_far}, std::pair{2 * g.stride, &g.down_far}})
    far_.push_back({offset, weight, Plane<double>(g.size, 0.0)});
  for (auto* plane : {&x_, &g_, &base_, &along_, &v_}) plane->assign(3 * g.size, 0.0);
  air_.assign(6 * g.size, 0.0);
  mass_.resize(vertices()), target_.resize(3 * vertices());
}

void Potential::pad(const double* from, Plane<double>& to) const {
  double* const planes[3] = {to.data(), to.data() + geometry_.size, to.data() + 2 * geometry_.size};
  geometry_.pad(from, planes);
  geometry_.wrap(planes);
}

void Potential::begin(const Stage& s) {
  const Geometry<double>& g = geometry_;
  const Material& m = s.material;
  const int n = vertices();
  pad(s.base, base_), pad(s.along, along_);
  pulls_.clear();
  tau_ = s.tau;
  const double ratio = m.damping / s.tau;
  const auto each = [&](auto body) {
    for (int r = 0; r < g.rows; ++r)
      for (int c = 0; c < g.cols; ++c) body(g.at(r, c), r * g.cols + c);
  };
  for (Springs& e : springs_) {
    const double modulus = e.linear ? m.stretch_stiffness : m.shear_stiffness;
    each([&](int i, int) {
      double square = kTiny, before = 0;
      for (int axis = 0; axis < 3; ++axis) {
        const std::size_t at = axis * g.size + i;
        const double d = along_[at + e.offset] - along_[at];
        square += d * d, before += d * (base_[at + e.offset] - base_[at]);
      }
      e.stiffness[i] = modulus * (*e.weight)[i] * (1 + ratio);
      e.rest[i] = (e.length + ratio * before / std::sqrt(square)) / (1 + ratio);
      e.bend[i] = m.bend_stiffness * ((e.linear ? (*e.linear)[i] : 0.0) + m.twist * e.twist * (*e.weight)[i]);
    });
  }
  for (Far& e : far_) each([&](int i, int) { e.bend[i] = m.bend_stiffness * (*e.weight)[i]; });

  // Corners as in sheet/air.hpp.
  std::copy_n(s.wind, 3, wind_velocity_);
  std::fill(g_.begin(), g_.end(), 0.0);  // the pressure's force for now
  const int corner[4] = {0, 1, g.stride + 1, g.stride};
  if (sheet_.air) pad(s.velocity, v_);
  const auto vector = [&](const Plane<double>& from, int i) -> Vec<double> {
    return {from[i], from[g.size + i], from[2 * g.size + i]};
  };
  if (sheet_.air || s.pressure != 0)
    each([&](int i, int) {
      if (g.cell[i] == 0) return;
      Vec<double> x[4], u = {-s.wind[0], -s.wind[1], -s.wind[2]};
      for (int k = 0; k < 4; ++k) x[k] = vector(along_, i + corner[k]), u = u + 0.25 * vector(v_, i + corner[k]);
      const Vec<double> area = cross(x[2] - x[0], x[1] - x[3]);  // twice
      for (int k = 0; k < 4; ++k) {
        const Vec<double>&p = x[(k + 1) % 4], &q = x[(k + 2) % 4], &r = x[(k + 3) % 4];
        const Vec<double> push = s.pressure / 12 * (2.0 * area - cross(r - p, q - p));
        double* const at = g_.data() + i + corner[k];
        at[0] += push.x, at[g.size] += push.y, at[2 * g.size] += push.z;
      }
      const double twice = std::sqrt(dot(area, area) + kTiny), through = dot(u, area) / twice;
      const double slide = sheet_.air_lift * std::sqrt(std::max(dot(u, u) - through * through, 0.0));
      const double own = kOwn * twice / 16 * (sheet_.air_normal * std::fabs(through) + slide);
      const double all[6] = {area.x / twice, area.y / twice, area.z / twice, twice / 4, slide, own};
      for (int k = 0; k < 6; ++k) air_[k * g.size + i] = all[k];
    });
  each([&](int i, int v) {
    const double area = 1 / g.inverse_area[i];
    mass_[v] = m.areal_density * area * s.inertia;
  });
  if (s.pressure != 0) {
    fold();
    each([&](int i, int v) {
      for (int axis = 0; axis < 3; ++axis) s.target[axis * n + v] += g_[axis * g.size + i] / mass_[v];
    });
  }
  std::copy_n(s.target, 3 * n, target_.data());
}

void Potential::draw(const int* which, const double* stiffness, const double* places, int count) {
  for (int i = 0; i < count; ++i) pulls_.push_back({which[i], stiffness[i], places[i]});
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
  const auto& kernels = lanes<ImplicitLanes>();
  double energy = 0;
  for (const Springs& e : springs_)
    energy += kernels.springs(x_.data(), g_.data(), g.size, g.begin, g.end, e.offset, e.stiffness.data(), e.rest.data(),
                              e.bend.data());
  for (const Far& e : far_)
    energy += kernels.linear(x_.data(), g_.data(), g.size, g.begin, g.end, e.offset, e.bend.data());
  if (sheet_.air) {
    for (std::size_t i = 0; i < 3 * g.size; ++i) v_[i] = (x_[i] - base_[i]) / tau_;
    energy += tau_ * kernels.air(v_.data(), g_.data(), g.size, g.begin, g.end, g.stride, air_.data(), sheet_.air_normal,
                                 sheet_.air_tangential, wind_velocity_[0], wind_velocity_[1], wind_velocity_[2]);
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
  for (const Pull& p : pulls_) {
    const double d = x[p.at] - p.place, pull = p.stiffness * d;
    gradient[p.at] += pull;
    inertia += pull * d;
  }
  return energy + inertia / 2;
}

}  // namespace minicloth
