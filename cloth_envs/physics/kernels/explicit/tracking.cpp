#include "tracking.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

namespace minicloth {
namespace {

constexpr double kHold = 0.28;  // of the time in which what pulls acts, for which the forces on means are held

// Of `n` places `spacing` apart what each stands for [m].
template <class T>
Plane<T> shares(int n, double spacing, bool closed) {
  Plane<T> all(n, T(spacing));
  if (!closed) all.front() /= 2, all.back() /= 2;
  return all;
}

}  // namespace

Linear::Linear(const double* weights, int fine, int coarse_) : coarse(coarse_) {
  for (const double* row = weights; row < weights + std::ptrdiff_t(fine) * coarse; row += coarse) {
    std::vector<int> found;
    for (int c = 0; c < coarse; ++c)
      if (row[c] != 0) found.push_back(c);
    if (found.empty() || found.size() > 2) throw std::invalid_argument("a row needs one weight, or two");
    left.push_back(found.front()), right.push_back(found.back());
    share.push_back(found.size() > 1 ? row[found.back()] : 0);
  }
}

int Linear::shared(int at) const {
  for (std::size_t i = 0; i < left.size(); ++i)
    if (left[i] == at && share[i] == 0) return int(i);
  return -1;
}

template <class T>
Pull<T>::Pull(const Tracking& tracking, const Sheet& sheet, const Strips<T>& strips, const Material& material,
              std::size_t member, int lane, const Substeps& substeps)
    : tracking_(tracking),
      strips_(strips),
      material_(material),
      paths_(tracking.paths.data() + member * 3 * tracking.down.coarse * tracking.across.coarse),
      lane_(lane),
      rows_(tracking.down.coarse),
      cols_(tracking.across.coarse),
      count_(substeps.count),
      held_(substeps.held),
      periodic_(sheet.periodic),
      h_(sheet.frame_dt / substeps.count),
      row_length_(sheet.row_length * (sheet.rows - 1) / (rows_ - 1)),
      col_length_(sheet.periodic ? sheet.col_length * sheet.cols / cols_
                                 : sheet.col_length * (sheet.cols - 1) / (cols_ - 1)),
      down_(shares<T>(sheet.rows, sheet.row_length, false)),
      across_(shares<T>(sheet.cols, sheet.col_length, sheet.periodic)) {
  const int n = rows_ * cols_;
  for (Plane<T>* field : {&x_, &v_, &past_, &pull_}) field->assign(3 * n, T(0));
  row_.resize(3 * std::max(sheet.cols, cols_));
  const auto add = [&](int r, int c) {
    places_.push_back(strips_.places[std::size_t(r) * sheet.cols + c] + lane_);
    area_.push_back(down_[r] * across_[c]);
  };
  if (tracking.means) {
    every_ = std::max(1, int(kHold / (tracking.rate * std::max(1.0, 2 * tracking.damping) * h_ * held_)));
    for (int r = 0; r < sheet.rows; ++r)
      for (int c = 0; c < sheet.cols; ++c) add(r, c);
    const auto sums = [](const Linear& line, const Plane<T>& of) {
      Plane<T> all(line.coarse, T(0));
      for (std::size_t i = 0; i < line.left.size(); ++i)
        all[line.left[i]] += T((1 - line.share[i]) * of[i]), all[line.right[i]] += T(line.share[i] * of[i]);
      return all;
    };
    const Plane<T> of_rows = sums(tracking.down, down_), of_cols = sums(tracking.across, across_);
    for (const T row : of_rows)
      for (const T col : of_cols) weight_.push_back(1 / (row * col));
  } else {
    for (int r = 0; r < rows_; ++r)
      for (int c = 0; c < cols_; ++c) add(tracking.down.shared(r), tracking.across.shared(c));
  }
  force_.assign(3 * places_.size(), T(0));
}

template <class T>
void Pull<T>::step(const Fields<T>& f, int k, bool fresh) {
  const std::size_t n = places_.size();
  const auto add = [&](T sign) {
    for (int axis = 0; axis < 3; ++axis)
      for (std::size_t i = 0; i < n; ++i) f.slow[places_[i] + axis * strips_.width] += sign * force_[axis * n + i];
  };
  if (tracking_.means) {
    if (!fresh) return;
    if (k % (held_ * every_) == 0) pull_means(f, k);
  } else {
    if (!fresh) add(-1);
    pull_shared(f, k);
  }
  add(1);
}

// What y is accelerated by at `s` of the frame.
template <class T>
void Pull<T>::accelerate(double s) {
  const double stiff = tracking_.rate * tracking_.rate, damper = 2 * tracking_.damping * tracking_.rate;
  for (std::size_t i = 0; i < x_.size(); ++i)
    pull_[i] = T(stiff * (paths_[i].position(s) - x_[i]) + damper * (paths_[i].velocity(s) / (h_ * count_) - v_[i]));
}

// The means of a field.
template <class T>
void Pull<T>::mean(const T* field, Plane<T>& to) {
  const int fine_rows = int(down_.size()), fine_cols = int(across_.size()), n = rows_ * cols_;
  std::fill(to.begin(), to.end(), T(0));
  for (int axis = 0; axis < 3; ++axis)
    for (int r = 0; r < fine_rows; ++r) {
      std::fill_n(row_.begin(), cols_, T(0));
      const int* const at = places_.data() + std::size_t(r) * fine_cols;
      for (int c = 0; c < fine_cols; ++c) {
        const T x = across_[c] * field[at[c] + axis * strips_.width], share = T(tracking_.across.share[c]);
        row_[tracking_.across.left[c]] += x - share * x, row_[tracking_.across.right[c]] += share * x;
      }
      const T share = T(tracking_.down.share[r]);
      T* const left = to.data() + axis * n + tracking_.down.left[r] * cols_;
      T* const right = to.data() + axis * n + tracking_.down.right[r] * cols_;
      for (int c = 0; c < cols_; ++c)
        left[c] += down_[r] * (1 - share) * row_[c], right[c] += down_[r] * share * row_[c];
    }
  for (int axis = 0; axis < 3; ++axis)
    for (int i = 0; i < n; ++i) to[axis * n + i] *= weight_[i];
}

template <class T>
void Pull<T>::pull_means(const Fields<T>& f, int k) {
  const int held = held_ * every_, n = rows_ * cols_, fine_cols = int(across_.size());
  const double later = middle(k, std::min(k + held, count_ + 1), count_), since = k > held ? held : held - 0.5;
  std::swap(past_, v_);
  mean(f.x, x_), mean(f.v, v_);
  const T trend = T(k ? (later + 0.5) / since : 0);  // velocities are half a substep old, but at a frame's start
  for (int i = 0; i < 3 * n; ++i) x_[i] += T(h_ * later) * v_[i];
  const Plane<T> now = v_;
  for (int i = 0; i < 3 * n; ++i) v_[i] += trend * (v_[i] - past_[i]);
  accelerate((k + later) / count_);
  v_ = now;
  for (int axis = 0; axis < 3; ++axis)
    for (int r = 0; r < int(down_.size()); ++r) {
      const T share = T(tracking_.down.share[r]);
      const T* const left = pull_.data() + axis * n + tracking_.down.left[r] * cols_;
      const T* const right = pull_.data() + axis * n + tracking_.down.right[r] * cols_;
      for (int c = 0; c < cols_; ++c) row_[c] = T(material_.areal_density) * (left[c] + share * (right[c] - left[c]));
      for (int c = 0; c < fine_cols; ++c) {
        const T a = row_[tracking_.across.left[c]], b = row_[tracking_.across.right[c]];
        const std::size_t i = std::size_t(r) * fine_cols + c;
        force_[axis * places_.size() + i] = area_[i] * (a + T(tracking_.across.share[c]) * (b - a));
      }
    }
}

template <class T>
void Pull<T>::pull_shared(const Fields<T>& f, int k) {
  const std::size_t n = places_.size();
  for (int axis = 0; axis < 3; ++axis)
    for (std::size_t i = 0; i < n; ++i) {
      x_[axis * n + i] = f.x[places_[i] + axis * strips_.width];
      v_[axis * n + i] = f.v[places_[i] + axis * strips_.width];
    }
  accelerate(k / double(count_));
  for (int axis = 0; axis < 3; ++axis)
    for (std::size_t i = 0; i < n; ++i)
      force_[axis * n + i] = T(material_.areal_density) * area_[i] * pull_[axis * n + i];
  if (tracking_.levels > 0) add_sheet();
}

// Of `n` edges from the vertices i, i + 1, ... to j, j + 1, ...: f = (k (l - L) + damping k l') / l d.
template <class T>
void Pull<T>::add_springs(int i, int j, int n, double stiffness, double length) {
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
void Pull<T>::add_differences(const std::vector<int>& at, const std::vector<double>& signs, int n, double stiffness) {
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
void Pull<T>::add_sheet() {
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

template class Pull<float>;
template class Pull<double>;

}  // namespace minicloth
