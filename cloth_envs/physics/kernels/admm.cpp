// Frames of P-ADMM.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <utility>

#include "admm_work.hpp"
#include "frames.hpp"

namespace minicloth {

namespace {
std::atomic<long> solvers{0};
}

template <class T>
Admm<T>::Admm(Geometry<T> geometry, World world, int substeps, int iterations, double weight, const double* row_basis,
              const double* col_basis)
    : geometry_(std::move(geometry)),
      world_(std::move(world)),
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
  for (int v : world_.handles) held_rows_.push_back(v / geometry_.cols);
  std::sort(held_rows_.begin(), held_rows_.end());
  held_rows_.erase(std::unique(held_rows_.begin(), held_rows_.end()), held_rows_.end());
  for (int v : world_.handles)
    held_row_of_.push_back(
        int(std::lower_bound(held_rows_.begin(), held_rows_.end(), v / geometry_.cols) - held_rows_.begin()));
  std::vector<bool> held(rows_.n * cols_.n);
  for (int v : world_.handles) held[v] = true;
  for (int v = 0; v < int(held.size()); ++v)
    if (!held[v]) free_.push_back(geometry_.at(v / cols_.n, v % cols_.n));
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
  for (auto* plane : {&work.held, &work.pull}) plane->assign(3 * padded(int(world_.handles.size())), T(0));
  return work;
}

template <class T>
void Admm<T>::advance(const Frame<T>& f, const System<T>& system) const {
  const Geometry<T>& g = geometry_;
  const World& world = world_;
  const AdmmLanes<T>& lanes = best_admm_lanes<T>();
  AdmmWork<T>& w = scratch();
  const int n = g.rows * g.cols;
  const Sheet& sheet = f.sheet;
  for (int k = 0; k < 3; ++k)
    for (int r = 0; r < g.rows; ++r) {
      std::copy_n(f.x + k * n + r * g.cols, g.cols, w.now.x[k] + g.at(r, 0));
      std::copy_n(f.v + k * n + r * g.cols, g.cols, w.now.v[k] + g.at(r, 0));
    }
  const double dt = world.frame_dt / substeps_, frame_dt = world.frame_dt;
  const double decay = std::exp(-sheet.drag * dt);
  const double lag = sheet.drag > 0 ? -std::expm1(-sheet.drag * dt) / sheet.drag : dt;
  const double stiffer = 1 + sheet.damping / dt;
  const LocalTerms<T> terms{T(weight_ * stiffer * sheet.stretch), T(weight_ * stiffer * sheet.shear), T(sheet.bend),
                            T(1 / (1 + weight_)), T(sheet.density / (dt * dt))};
  const double slow = dt / (2 * sheet.density);
  const GustTerms<T> blow{
      T(world.wind_normal / 4),    T(world.wind_tangential / 4),    T(world.pressure ? f.pressure : 0.0),
      T(slow * world.wind_normal), T(slow * world.wind_tangential), {T(f.wind[0]), T(f.wind[1]), T(f.wind[2])}};
  const auto wrap = [&](T* const(&planes)[3]) {
    for (T* plane : planes)
      for (int r = 0; r < g.rows; ++r) {
        T* row = plane + g.at(r, 0);
        for (int k = 1; k <= kGhost; ++k) row[-k] = row[g.cols - k], row[g.cols + k - 1] = row[k - 1];
      }
  };
  std::vector<Cubic> handles(3 * world.handles.size()), bodies(6 * world.bodies.size());
  for (std::size_t i = 0; i < handles.size(); ++i) {
    const std::size_t from = i % 3 * n + world.handles[i / 3];
    handles[i] = {f.x[from], f.v[from] * frame_dt, f.handle_x[i], f.handle_v[i] * frame_dt};
  }
  for (std::size_t i = 0; i < bodies.size(); ++i)
    bodies[i] = {f.body_x[i], f.body_v[i] * frame_dt, f.body_x_end[i], f.body_v_end[i] * frame_dt};
  std::vector<BodyStep<T>> steps(world.bodies.size());

  for (int substep = 0; substep < substeps_; ++substep) {
    const double s0 = double(substep) / substeps_, s1 = double(substep + 1) / substeps_;
    for (std::size_t b = 0; b < steps.size(); ++b) {
      steps[b].plane = world.bodies[b].plane, steps[b].friction = T(world.bodies[b].friction);
      steps[b].radius = T(world.bodies[b].radius + world.thickness), steps[b].dt = T(dt);
      for (int i = 0; i < 6; ++i) {
        steps[b].before[i / 3][i % 3] = T(bodies[6 * b + i].position(s0));
        steps[b].after[i / 3][i % 3] = T(bodies[6 * b + i].position(s1));
      }
    }
    const auto drive = [&](T* const(&planes)[3], bool velocity) {
      for (std::size_t i = 0; i < handles.size(); ++i) {
        const int v = world.handles[i / 3];
        planes[i % 3][g.at(v / g.cols, v % g.cols)] =
            T(velocity ? handles[i].velocity(s1) / frame_dt : handles[i].position(s1));
      }
    };
    if (g.periodic) wrap(w.now.x), wrap(w.now.v);
    lanes.rest(g, T(sheet.damping / dt), w.now.x, w.rest);
    const bool air = world.wind || world.pressure;
    if (air) lanes.gust(g, blow, w.now, w.air);
    // The prediction x + h v + h^2 (g + f / m), with drag integrated exactly.
    const T keep = T(dt * decay), kick = T(dt * lag / sheet.density), fall = T(dt * lag * world.gravity);
    for (int k = 0; k < 3; ++k) {
      const T drop = k == 2 ? fall : T(0);
      for (int i = g.begin; i < g.end; ++i) {
        T force = 0;
        if (air)
          force = w.air.corner[0][k][i] + w.air.corner[1][k][i - 1] +
                  (w.air.corner[2][k][i - g.stride - 1] + w.air.corner[3][k][i - g.stride]);
        w.goal[k][i] = w.now.x[k][i] + keep * w.now.v[k][i] + (kick * g.inverse_area[i] * force - drop);
        w.x[k][i] = w.goal[k][i];
      }
    }
    for (auto& edge : w.u.p)
      for (T* plane : edge) std::fill_n(plane, g.size, T(0));
    approach(steps, w);
    for (int k = 0; k < iterations_; ++k) {
      drive(w.x, false);
      if (g.periodic) wrap(w.x);
      lanes.local(g, terms, area_.data(), w.goal, w.x, w.u, w.rest, w.tail, w.residual);
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
    drive(w.now.x, false), drive(w.now.v, true);
  }
  for (int k = 0; k < 3; ++k)
    for (int r = 0; r < g.rows; ++r) {
      std::copy_n(w.now.x[k] + g.at(r, 0), g.cols, f.x_out + k * n + r * g.cols);
      std::copy_n(w.now.v[k] + g.at(r, 0), g.cols, f.v_out + k * n + r * g.cols);
    }
}

template <class T>
void Admm<T>::advance(const std::vector<Frame<T>>& frames, const Systems& systems, int threads) const {
  for_each_member(frames.size(), threads, [&](std::size_t i) { advance(frames[i], *systems[i]); });
}

template class Admm<float>;
template class Admm<double>;

}  // namespace minicloth
