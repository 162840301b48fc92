// Frames of P-ADMM.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <utility>

#include "../base/threads.hpp"
#include "../sheet/drives.hpp"
#include "work.hpp"

namespace minicloth {

namespace {
std::atomic<long> solvers{0};
}

template <class T>
Admm<T>::Admm(Sheet sheet, int substeps, int iterations, double weight, const double* row_basis,
              const double* col_basis)
    : sheet_(std::move(sheet)),
      geometry_(sheet_.rows, sheet_.cols, sheet_.row_length, sheet_.col_length, sheet_.periodic),
      substeps_(substeps),
      iterations_(iterations),
      weight_(weight),
      rows_(geometry_.rows, row_basis),
      cols_(geometry_.cols, col_basis),
      line_(cols_.even + padded(cols_.odd)),
      width_(padded(3 * line_)),
      area_(geometry_.size, T(0)),
      id_(solvers++) {
  for (std::size_t i = 0; i < area_.size(); ++i)
    if (geometry_.inverse_area[i] > 0) area_[i] = 1 / geometry_.inverse_area[i];
  for (int v : sheet_.handles) held_rows_.push_back(v / geometry_.cols);
  std::sort(held_rows_.begin(), held_rows_.end());
  held_rows_.erase(std::unique(held_rows_.begin(), held_rows_.end()), held_rows_.end());
  for (int v : sheet_.handles)
    held_row_of_.push_back(
        int(std::lower_bound(held_rows_.begin(), held_rows_.end(), v / geometry_.cols) - held_rows_.begin()));
  std::vector<bool> held(rows_.n * cols_.n);
  for (std::size_t i = 0; i < sheet_.handles.size(); ++i) held[sheet_.handles[i]] = std::isinf(sheet_.hold[3 * i]);
  for (int v = 0; v < int(held.size()); ++v)
    if (!held[v]) free_.push_back(geometry_.at(v));
  for (int r : held_rows_)
    held_basis_.insert(held_basis_.end(), rows_.all.begin() + r * rows_.n, rows_.all.begin() + (r + 1) * rows_.n);
}

template <class T>
AdmmWork<T>& Admm<T>::scratch() const {
  thread_local AdmmWork<T> work;
  if (work.owner == id_) return work;
  work.owner = id_;
  work.memory.assign(58 * geometry_.size, T(0));
  T* p = work.memory.data();
  const auto take = [&](auto& planes) {
    for (T*& plane : planes) plane = std::exchange(p, p + geometry_.size);
  };
  take(work.now.x), take(work.now.v), take(work.x), take(work.goal), take(work.residual), take(work.rest);
  take(work.tail), take(work.shift);
  for (auto& edge : work.u.p) take(edge);
  for (auto& corner : work.air.corner) take(corner);
  const std::size_t rows = rows_.n, held = held_rows_.size();
  work.folded.assign(3 * rows * cols_.n, T(0));
  for (auto* plane : {&work.first, &work.second, &work.third}) plane->assign(rows * width_, T(0));
  work.places.assign(rows * 2 * padded(cols_.even), T(0));
  work.held_lines.assign(held * width_, T(0));
  for (auto* plane : {&work.held, &work.pull}) plane->assign(3 * padded(int(sheet_.handles.size())), T(0));
  return work;
}

template <class T>
void Admm<T>::advance(const Frame<T>& f, const System<T>& system) const {
  const Geometry<T>& g = geometry_;
  const auto& kernels = lanes<AdmmLanes<T>>();
  AdmmWork<T>& w = scratch();
  const Material& m = system.material;
  g.pad(f.x, w.now.x), g.pad(f.v, w.now.v);
  const double dt = sheet_.frame_dt / substeps_;
  const double decay = std::exp(-m.drag * dt);
  const double lag = m.drag > 0 ? -std::expm1(-m.drag * dt) / m.drag : dt;
  const double stiffer = 1 + m.damping / dt;
  const T twist = T(m.bend_stiffness * m.twist);
  const LocalTerms<T> terms{T(weight_ * stiffer * m.stretch_stiffness),
                            T(weight_ * stiffer * m.shear_stiffness),
                            T(m.bend_stiffness),
                            g.twist_along * twist,
                            g.twist_down * twist,
                            g.twist_diagonal * twist,
                            T(1 / (1 + weight_)),
                            T(m.areal_density / (dt * dt))};
  const AirTerms<T> blow = air_terms(sheet_, f, dt / (2 * m.areal_density));
  const bool air = sheet_.air || sheet_.pressure;
  auto handles = handles_of(sheet_, f, m.stretch_stiffness / m.areal_density, [&](int vertex) { return g.at(vertex); });
  for (Handle& h : handles) h.moves = true;  // on its cubic even at rest, which turns -0 into 0
  MovingBodies<T> bodies(sheet_, f, dt);

  for (int substep = 0; substep < substeps_; ++substep) {
    const double end = double(substep + 1) / substeps_;
    const auto& steps = bodies.to(end);
    g.wrap(w.now.x), g.wrap(w.now.v);
    kernels.rest(g, T(m.damping / dt), w.now.x, w.rest);
    // The prediction x + h v + h^2 (g + f / m), with drag integrated exactly.
    const T keep = T(dt * decay), kick = T(dt * lag / m.areal_density), fall = T(dt * lag * sheet_.gravity);
    for (int k = 0; k < 3; ++k) {
      const T drop = k == 2 ? fall : T(0);
      for (int i = g.begin; i < g.end; ++i)
        w.goal[k][i] = w.now.x[k][i] + (keep * w.now.v[k][i] - drop), w.x[k][i] = w.goal[k][i];
    }
    // The air's force at the velocities that x has without it, at first and again with what springs do half way.
    const auto blown = [&](int k, int i) {
      return kick * g.inverse_area[i] *
             (w.air.corner[0][k][i] + w.air.corner[1][k][i - 1] +
              (w.air.corner[2][k][i - g.stride - 1] + w.air.corner[3][k][i - g.stride]));
    };
    const auto blow_again = [&](bool first) {
      for (int k = 0; k < 3; ++k)
        for (int i = g.begin; i < g.end; ++i) {
          const T before = first ? T(0) : blown(k, i);
          w.now.v[k][i] = (w.x[k][i] - w.now.x[k][i] - before) / T(dt), w.goal[k][i] -= before;
        }
      g.wrap(w.now.v);
      kernels.air(g, blow, w.now, w.air);
      for (int k = 0; k < 3; ++k)
        for (int i = g.begin; i < g.end; ++i) w.goal[k][i] += blown(k, i);
    };
    if (air) {
      blow_again(true);
      for (int k = 0; k < 3; ++k) std::copy(w.goal[k] + g.begin, w.goal[k] + g.end, w.x[k] + g.begin);
    }
    for (auto& edge : w.u.p)
      for (T* plane : edge) std::fill_n(plane, g.size, T(0));
    approach(steps, w);
    for (int k = 0; k < iterations_; ++k) {
      if (air && k > 0 && k == iterations_ / 2) blow_again(false);
      put_positions(handles, end, w.x);
      g.wrap(w.x);
      kernels.local(g, terms, area_.data(), w.goal, w.x, w.u, w.rest, w.tail, w.residual);
      for (const Handle& h : handles)
        for (int axis = 0; !h.firm() && axis < 3; ++axis)
          w.residual[axis][h.at] +=
              T(h.rate[axis] * m.areal_density * area_[h.at] * (h.position(axis, end) - w.x[axis][h.at]));
      w.contact.active.clear();
      if (!steps.empty()) push(steps, terms, w);
      correct(system, w, w.x);
      if (!w.contact.active.empty()) settle(system, w);
    }
    project(steps, w);
    const T rate = T(1 / dt);
    for (int k = 0; k < 3; ++k)
      for (int i : free_) {
        w.now.v[k][i] = rate * (w.x[k][i] - w.now.x[k][i]);
        w.now.x[k][i] = w.x[k][i];
      }
    put_positions(handles, end, w.now.x), put_velocities(handles, end, w.now.v);
  }
  g.unpad(w.now.x, f.x_out), g.unpad(w.now.v, f.v_out);
}

template <class T>
void Admm<T>::advance(const std::vector<Frame<T>>& frames, const Systems& systems, int threads) const {
  for_each_member(frames.size(), threads, [&](std::size_t i) { advance(frames[i], *systems[i]); });
}

template class Admm<float>;
template class Admm<double>;

}  // namespace minicloth
