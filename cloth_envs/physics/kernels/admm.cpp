#include "admm.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <utility>

#include "admm_contact.hpp"
#include "frames.hpp"

namespace minicloth {

namespace {
std::atomic<long> solvers{0};
}

template <class T>
Fold<T>::Fold(int n_, const double* basis) : n(n_), even((n_ + 1) / 2), odd(n_ / 2), all(std::size_t(n_) * n_) {
  std::copy_n(basis, all.size(), all.begin());
  const auto half = [&](int count, int first, Plane<T>& to, Plane<T>& from) {
    const int line = padded(count);
    to.assign(std::size_t(count) * line, T(0)), from = to;
    for (int i = 0; i < count; ++i)
      for (int k = 0; k < count; ++k) to[i * line + k] = from[k * line + i] = all[i * n + first + k];
  };
  half(even, 0, to_even, from_even), half(odd, even, to_odd, from_odd);
}

template <class T>
struct AdmmWork {
  long owner = -1;
  Plane<T> memory;
  Planes<T> now;  // at the step's start
  T *x[3], *goal[3], *residual[3], *rest[4], *tail[9];
  EdgePlanes<T> u;
  Cells<T> air;
  // Transforms: half rows (3 H, W); modes and half columns (H, width); places along a row (H, padded halves).
  Plane<T> folded, first, second, third, places;
  Plane<T> held_lines, held, pull;  // (held rows, width), (3, padded p) twice
  Patch<T> contact;
};

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
System<T> Admm<T>::system(const double* eigenvalues, const double* capacitance) const {
  const int p = int(world_.handles.size()), line = padded(p);
  System<T> out{Plane<T>(std::size_t(rows_.n) * line_, T(0)), Plane<T>(std::size_t(p) * line, T(0))};
  for (int k = 0; k < rows_.n; ++k)
    for (int l = 0; l < cols_.n; ++l) out.inverse[k * line_ + l] = T(1 / eigenvalues[k * cols_.n + l]);
  for (int i = 0; i < p; ++i) std::copy_n(capacitance + i * p, p, out.capacitance.begin() + i * line);
  return out;
}

template <class T>
AdmmWork<T>& Admm<T>::scratch() const {
  thread_local AdmmWork<T> work;
  if (work.owner == id_) return work;
  work.owner = id_;
  work.memory.assign(55 * geometry_.size, T(0));
  T* p = work.memory.data();
  const auto take = [&](auto& planes) {
    for (T*& plane : planes) plane = std::exchange(p, p + geometry_.size);
  };
  take(work.now.x), take(work.now.v), take(work.x), take(work.goal), take(work.residual), take(work.rest);
  take(work.tail);
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

// Takes from the modes in `second` what moves the held vertices: second -= A^-1 S C^-1 S^T second.
template <class T>
void Admm<T>::hold(const System<T>& system, AdmmWork<T>& w) const {
  const auto multiply = best_admm_lanes<T>().multiply;
  const int rows = rows_.n, cols = cols_.n, p = int(world_.handles.size()), line = padded(p);
  const int distinct = int(held_rows_.size());
  multiply(distinct, rows, width_, held_basis_.data(), rows, 1, w.second.data(), width_, w.held_lines.data(), width_);
  for (int i = 0; i < p; ++i)
    for (int k = 0; k < 3; ++k) {
      const T* at = w.held_lines.data() + held_row_of_[i] * width_ + k * line_;
      const T* basis = cols_.all.data() + world_.handles[i] % cols * cols;
      T sum = 0;
      for (int l = 0; l < cols; ++l) sum += at[l] * basis[l];
      w.held[k * line + i] = sum;
    }
  multiply(3, p, line, w.held.data(), line, 1, system.capacitance.data(), line, w.pull.data(), line);
  std::fill(w.held_lines.begin(), w.held_lines.end(), T(0));
  for (int i = 0; i < p; ++i)
    for (int k = 0; k < 3; ++k) {
      T* at = w.held_lines.data() + held_row_of_[i] * width_ + k * line_;
      const T* basis = cols_.all.data() + world_.handles[i] % cols * cols;
      const T pull = w.pull[k * line + i];
      for (int l = 0; l < cols; ++l) at[l] += pull * basis[l];
    }
  multiply(rows, distinct, width_, held_basis_.data(), 1, rows, w.held_lines.data(), width_, w.first.data(), width_);
  for (int r = 0; r < rows; ++r)
    for (int k = 0; k < 3; ++k) {
      T *to = w.second.data() + r * width_ + k * line_, *from = w.first.data() + r * width_ + k * line_;
      const T* inverse = system.inverse.data() + r * line_;
      for (int l = 0; l < cols; ++l) to[l] -= from[l] * inverse[l];
    }
}

template <class T>
void Admm<T>::correct(const System<T>& system, AdmmWork<T>& w) const {
  const Geometry<T>& g = geometry_;
  const auto multiply = best_admm_lanes<T>().multiply;
  const int rows = rows_.n, cols = cols_.n, re = rows_.even, ro = rows_.odd, ce = cols_.even, co = cols_.odd;
  for (int v : world_.handles)
    for (T* plane : w.residual) plane[g.at(v / cols, v % cols)] = 0;
  // Columns to modes: sums and differences about the middle, then half the products.
  for (int r = 0; r < rows; ++r)
    for (int k = 0; k < 3; ++k) {
      const T* from = w.residual[k] + g.at(r, 0);
      T* to = w.folded.data() + (3 * r + k) * cols;
      for (int c = 0; c < co; ++c) to[c] = from[c] + from[cols - 1 - c], to[ce + c] = from[c] - from[cols - 1 - c];
      if (ce > co) to[co] = from[co];
    }
  for (int k = 0; k < 3; ++k) {
    const T* from = w.folded.data() + k * cols;
    T* to = w.first.data() + k * line_;
    multiply(rows, ce, padded(ce), from, 3 * cols, 1, cols_.to_even.data(), padded(ce), to, width_);
    multiply(rows, co, padded(co), from + ce, 3 * cols, 1, cols_.to_odd.data(), padded(co), to + ce, width_);
  }
  // Rows to modes.
  const auto row = [&](Plane<T>& plane, int r) { return plane.data() + r * width_; };
  for (int r = 0; r < ro; ++r) {
    const T *up = row(w.first, r), *low = row(w.first, rows - 1 - r);
    T *sum = row(w.third, r), *difference = row(w.third, re + r);
    for (int i = 0; i < width_; ++i) sum[i] = up[i] + low[i], difference[i] = up[i] - low[i];
  }
  if (re > ro) std::copy_n(row(w.first, ro), width_, row(w.third, ro));
  multiply(re, re, width_, rows_.to_even.data(), 1, padded(re), row(w.third, 0), width_, row(w.second, 0), width_);
  multiply(ro, ro, width_, rows_.to_odd.data(), 1, padded(ro), row(w.third, re), width_, row(w.second, re), width_);
  for (int r = 0; r < rows; ++r)
    for (int k = 0; k < 3; ++k) {
      T* at = row(w.second, r) + k * line_;
      const T* inverse = system.inverse.data() + r * line_;
      for (int l = 0; l < line_; ++l) at[l] *= inverse[l];
    }
  if (!world_.handles.empty()) hold(system, w);
  // And back.
  multiply(re, re, width_, rows_.to_even.data(), padded(re), 1, row(w.second, 0), width_, row(w.third, 0), width_);
  multiply(ro, ro, width_, rows_.to_odd.data(), padded(ro), 1, row(w.second, re), width_, row(w.third, re), width_);
  for (int r = 0; r < ro; ++r) {
    const T *even = row(w.third, r), *odd = row(w.third, re + r);
    T *up = row(w.first, r), *low = row(w.first, rows - 1 - r);
    for (int i = 0; i < width_; ++i) up[i] = even[i] + odd[i], low[i] = even[i] - odd[i];
  }
  if (re > ro) std::copy_n(row(w.third, ro), width_, row(w.first, ro));
  const int half = padded(ce);
  for (int k = 0; k < 3; ++k) {
    const T* from = w.first.data() + k * line_;
    T* to = w.places.data();
    multiply(rows, ce, padded(ce), from, width_, 1, cols_.from_even.data(), padded(ce), to, 2 * half);
    multiply(rows, co, padded(co), from + ce, width_, 1, cols_.from_odd.data(), padded(co), to + half, 2 * half);
    for (int r = 0; r < rows; ++r) {
      const T *even = to + r * 2 * half, *odd = even + half;
      T* x = w.x[k] + g.at(r, 0);
      for (int c = 0; c < co; ++c) x[c] += even[c] + odd[c], x[cols - 1 - c] += even[c] - odd[c];
      if (ce > co) x[co] += even[co];
    }
  }
}

template <class T>
void Admm<T>::solve(const System<T>& system, const T* right, T* x) const {
  AdmmWork<T>& w = scratch();
  const int n = rows_.n * cols_.n, cols = cols_.n;
  for (int k = 0; k < 3; ++k)
    for (int r = 0; r < rows_.n; ++r) {
      std::copy_n(right + k * n + r * cols, cols, w.residual[k] + geometry_.at(r, 0));
      std::fill_n(w.x[k] + geometry_.at(r, 0), cols, T(0));
    }
  correct(system, w);
  for (int v : world_.handles)
    for (T* plane : w.x) plane[geometry_.at(v / cols, v % cols)] = 0;
  for (int k = 0; k < 3; ++k)
    for (int r = 0; r < rows_.n; ++r) std::copy_n(w.x[k] + geometry_.at(r, 0), cols, x + k * n + r * cols);
}

template <class T>
void Admm<T>::push(const std::vector<BodyStep<T>>& bodies, const LocalTerms<T>& terms, AdmmWork<T>& w) const {
  const Geometry<T>& g = geometry_;
  Patch<T>& c = w.contact;
  using Kind = typename Patch<T>::Kind;
  c.active.clear();
  for (int i : free_) {
    const Vec<T> x0 = pick(w.now.x, i), x1 = pick(w.x, i);
    Touch<T> most = {false, {}, 0, {}};
    for (const auto& body : bodies) {
      const Touch<T> t = touch(body, x0, x1);
      if (t.near && (!most.near || t.gap < most.gap)) most = t, c.friction[i] = body.friction;
    }
    if (!most.near || (most.gap >= 0 && c.kind[i] == Patch<T>::kFree)) {
      c.kind[i] = Patch<T>::kFree;
      continue;
    }
    if (c.kind[i] == Patch<T>::kFree) c.kind[i] = Patch<T>::kStick;
    c.normal[i] = most.normal, c.slip[i] = most.slip;
    c.error[i] = most.gap * most.normal;
    if (c.kind[i] == Patch<T>::kStick) c.error[i] = c.error[i] + most.slip;
    c.active.push_back(i);
  }
  const int s = g.stride;
  const auto wrapped = [&](int i, int step) {  // the place of a neighbour's values
    if (!g.periodic) return i + step;
    const int col = (i - g.origin) % s, right = step == 1 || step == s + 1 || step == 1 - s;
    const bool sideways = step != s && step != -s;
    return i + step + (sideways && right && col == g.cols - 1 ? -g.cols : 0) +
           (sideways && !right && col == 0 ? g.cols : 0);
  };
  std::vector<std::pair<Vec<T>, Kind>> next(c.active.size());
  for (std::size_t a = 0; a < c.active.size(); ++a) {
    const int i = c.active[a];
    const T inertia = terms.inertia * area_[i];
    Vec<T> force = T(-1) * pick(w.residual, i) - inertia * c.error[i];
    const auto edge = [&](int step, T k) {
      const int j = wrapped(i, step);
      if (k > 0 && c.kind[j] != Patch<T>::kFree) force = force - k * (c.error[i] - c.error[j]);
    };
    edge(1, terms.stretch * g.along[i]), edge(-1, terms.stretch * g.along[i - 1]);
    edge(s, terms.stretch * g.down[i]), edge(-s, terms.stretch * g.down[i - s]);
    edge(s + 1, terms.shear * g.right[i]), edge(-s - 1, terms.shear * g.right[i - s - 1]);
    edge(s - 1, terms.shear * g.left[i]), edge(1 - s, terms.shear * g.left[i - s + 1]);
    if (c.kind[i] == Patch<T>::kSlide) force = force - inertia * c.slip[i];
    const T pressing = dot(force, c.normal[i]), most = c.friction[i] * pressing;
    const Vec<T> along = force - pressing * c.normal[i];
    const T size = std::sqrt(dot(along, along));
    if (pressing <= 0)
      next[a] = {{0, 0, 0}, Patch<T>::kFree};
    else if (size <= most)
      next[a] = {force, Patch<T>::kStick};
    else
      next[a] = {pressing * c.normal[i] + (most / size) * along, Patch<T>::kSlide};
  }
  for (std::size_t a = 0; a < c.active.size(); ++a) {
    const int i = c.active[a];
    place(w.residual, i, pick(w.residual, i) + next[a].first);
    c.kind[i] = next[a].second;
  }
}

template <class T>
void Admm<T>::project(const std::vector<BodyStep<T>>& bodies, AdmmWork<T>& w) const {
  for (const auto& body : bodies)
    for (int i : free_) {
      const Vec<T> x = pick(w.x, i);
      const Touch<T> t = touch(body, pick(w.now.x, i), x);
      if (!t.near || t.gap >= 0) continue;
      const T size = std::sqrt(dot(t.slip, t.slip)), most = -body.friction * t.gap;
      place(w.x, i, x - t.gap * t.normal - (size > most ? most / size : T(1)) * t.slip);
    }
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
    w.contact.begin(steps.empty() ? 0 : g.size);
    for (int k = 0; k < iterations_; ++k) {
      drive(w.x, false);
      if (g.periodic) wrap(w.x);
      lanes.local(g, terms, area_.data(), w.goal, w.x, w.u, w.rest, w.tail, w.residual);
      if (!steps.empty()) push(steps, terms, w);
      correct(system, w);
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

template struct Fold<float>;
template struct Fold<double>;
template class Admm<float>;
template class Admm<double>;

}  // namespace minicloth
