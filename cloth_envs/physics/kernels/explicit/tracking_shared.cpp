// Cloths that are pulled along at the vertices that they share with coarser ones.
#include <algorithm>
#include <cmath>

#include "tracking.hpp"

namespace minicloth {

template <class T>
PullShared<T>::PullShared(const Tracking& tracking, const Sheet& sheet, const Strips<T>& strips,
                          const Material& material, std::size_t member, int lane, int count)
    : tracking_(tracking),
      material_(material),
      paths_(tracking.paths.data() + member * 3 * tracking.down.coarse * tracking.across.coarse),
      rows_(tracking.down.coarse),
      cols_(tracking.across.coarse),
      width_(strips.width),
      count_(count),
      periodic_(sheet.periodic),
      frame_dt_(sheet.frame_dt),
      row_length_(sheet.row_length * (sheet.rows - 1) / (rows_ - 1)),
      col_length_(sheet.periodic ? sheet.col_length * sheet.cols / cols_
                                 : sheet.col_length * (sheet.cols - 1) / (cols_ - 1)),
      row_(cols_) {
  const double cell = material.areal_density * sheet.row_length * sheet.col_length;
  for (int r = 0; r < rows_; ++r)
    for (int c = 0; c < cols_; ++c) {
      const int row = tracking.down.shared(r), col = tracking.across.shared(c);
      const bool border = !periodic_ && (c == 0 || c == cols_ - 1);
      places_.push_back(strips.places[std::size_t(row) * sheet.cols + col] + lane);
      mass_.push_back(T(cell * (r == 0 || r == rows_ - 1 ? 0.5 : 1) * (border ? 0.5 : 1)));
    }
  for (Plane<T>* field : {&x_, &v_, &force_}) field->assign(3 * places_.size(), T(0));
}

template <class T>
void PullShared<T>::add(const Fields<T>& f, T sign) const {
  const std::size_t n = places_.size();
  for (std::size_t axis = 0; axis < 3; ++axis)
    for (std::size_t i = 0; i < n; ++i) f.slow[places_[i] + axis * width_] += sign * force_[axis * n + i];
}

template <class T>
void PullShared<T>::step(const Fields<T>& f, int k, bool fresh) {
  if (!fresh) add(f, -1);
  const std::size_t n = places_.size();
  for (std::size_t axis = 0, at = 0; axis < 3; ++axis)
    for (std::size_t i = 0; i < n; ++i, ++at) {
      x_[at] = f.x[places_[i] + axis * width_], v_[at] = f.v[places_[i] + axis * width_];
      force_[at] = mass_[i] * T(tracking_.pull(paths_[at], k / double(count_), frame_dt_, x_[at], v_[at]));
    }
  if (tracking_.levels > 0) add_sheet();
  add(f, 1);
}

// Of `n` edges from the vertices i, i + 1, ... to j, j + 1, ...: f = (k (l - L) + damping k l') / l d.
template <class T>
void PullShared<T>::add_springs(int i, int j, int n, double stiffness, double length) {
  const std::size_t all = places_.size();
  const T k = T(stiffness * tracking_.levels), c = T(material_.damping) * k, rest = T(length);
  T* const pull = row_.data();
  const T *const x = x_.data(), *const v = v_.data();
  for (int e = 0; e < n; ++e) {
    T square = 0, speed = 0;
    for (std::size_t axis = 0; axis < 3 * all; axis += all) {
      const T d = x[axis + j + e] - x[axis + i + e];
      square += d * d, speed += d * (v[axis + j + e] - v[axis + i + e]);
    }
    const T l = std::sqrt(square);
    pull[e] = k - k * rest / l + c * speed / square;
  }
  for (std::size_t axis = 0; axis < 3 * all; axis += all) {
    for (int e = 0; e < n; ++e) {
      const T to = pull[e] * (x[axis + j + e] - x[axis + i + e]);
      force_[axis + i + e] += to, force_[axis + j + e] -= to;
    }
  }
}

// Of `n` vertices and those beside them: minus the gradient of k |sum of signs times x|^2 / 2.
template <class T>
void PullShared<T>::add_differences(const std::vector<int>& at, const std::vector<double>& signs, int n,
                                    double stiffness) {
  const std::size_t all = places_.size();
  for (std::size_t axis = 0; axis < 3 * all; axis += all)
    for (int e = 0; e < n; ++e) {
      T difference = 0;
      for (std::size_t i = 0; i < at.size(); ++i) difference += T(signs[i]) * x_[axis + at[i] + e];
      difference *= T(stiffness * tracking_.levels);
      for (std::size_t i = 0; i < at.size(); ++i) force_[axis + at[i] + e] -= T(signs[i]) * difference;
    }
}

// The weights are those of cloth_envs/physics/laws/stencil.py.
template <class T>
void PullShared<T>::add_sheet() {
  const Material& m = material_;
  const double a = row_length_, b = col_length_, diagonal = std::hypot(a, b);
  const double stretch = m.stretch_stiffness, shear = m.shear_stiffness * diagonal * diagonal / (2 * a * b);
  const std::vector<double> second = {1, -2, 1}, mixed = {1, -1, -1, 1};
  const double twist = 2 * m.bend_stiffness * m.twist / (a * b);
  // Columns and those to the right of them: of a tube the last one's is the first.
  const auto pairs = [&](const auto& run) {
    run(0, 1, cols_ - 1);
    if (periodic_) run(cols_ - 1, 0, 1);
  };
  for (int r = 0; r < rows_; ++r) {
    const int up = (r - 1) * cols_, here = r * cols_, down = here + cols_;
    const double row = r == 0 || r == rows_ - 1 ? 0.5 : 1;
    pairs([&](int c, int right, int n) { add_springs(here + c, here + right, n, row * stretch * a / b, b); });
    const auto side = [&](const auto& run) {  // the columns, those at an open border with half the weight
      const int border = periodic_ ? 0 : 1;
      if (border) run(0, 1, 0.5), run(cols_ - 1, 1, 0.5);
      run(border, cols_ - 2 * border, 1.0);
    };
    if (r > 0 && r < rows_ - 1)
      side([&](int c, int n, double share) {
        add_differences({up + c, here + c, down + c}, second, n, share * m.bend_stiffness * b / (a * a * a));
      });
    const double bend = row * m.bend_stiffness * a / (b * b * b);
    for (int c = periodic_ ? 0 : 1; c < (periodic_ ? cols_ : cols_ - 1); ++c)
      add_differences({here + (c + cols_ - 1) % cols_, here + c, here + (c + 1) % cols_}, second, 1, bend);
    if (r == rows_ - 1) continue;
    side([&](int c, int n, double share) { add_springs(here + c, down + c, n, share * stretch * b / a, a); });
    pairs([&](int c, int right, int n) {
      add_springs(here + c, down + right, n, shear, diagonal), add_springs(here + right, down + c, n, shear, diagonal);
      add_differences({here + c, here + right, down + c, down + right}, mixed, n, twist);
    });
  }
}

template class PullShared<float>;
template class PullShared<double>;

}  // namespace minicloth
