#include "tracking.hpp"

#include <algorithm>
#include <stdexcept>

namespace minicloth {
namespace {

constexpr double kHold = 0.28;  // of the time in which what pulls acts, for which the forces on means are held

// Of `n` places `spacing` apart what each stands for [m].
template <class T>
std::vector<T> sizes(int n, double spacing, bool closed) {
  std::vector<T> all(n, T(spacing));
  if (!closed) all.front() /= 2, all.back() /= 2;
  return all;
}

// For how many times `time` [s] the forces on means are held, `most` at most.
int hold(const Tracking& tracking, double time, int most) {
  const double fits = kHold / (tracking.rate * std::max(1.0, 2 * tracking.damping) * time);
  return int(std::clamp(fits, 1.0, double(most)));
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
PullMeans<T>::PullMeans(const Tracking& tracking, const Sheet& sheet, const Strips<T>& strips,
                        const std::vector<Material>& materials, const std::vector<std::size_t>& members,
                        const Substeps& substeps)
    : tracking_(tracking),
      strips_(strips),
      rows_(strips.turned ? Side{tracking.across, sizes<T>(sheet.cols, sheet.col_length, false)}
                          : Side{tracking.down, sizes<T>(sheet.rows, sheet.row_length, false)}),
      cols_(strips.turned ? Side{tracking.down, sizes<T>(sheet.rows, sheet.row_length, false)}
                          : Side{tracking.across, sizes<T>(sheet.cols, sheet.col_length, sheet.periodic)}),
      count_(substeps.count),
      held_(substeps.held * hold(tracking, sheet.frame_dt * substeps.held / substeps.count, substeps.count)),
      frame_dt_(sheet.frame_dt),
      row_(std::size_t(cols_.line.coarse) * 3 * strips.width),
      force_(strips.field, T(0)) {
  const int h = rows_.line.coarse, w = cols_.line.coarse, down = tracking.down.coarse, across = tracking.across.coarse;
  for (const std::size_t member : members) {
    densities_.push_back(materials[member].areal_density);
    for (int i = 0; i < h * w; ++i)
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const int at = strips.turned ? i % w * across + i / w : i;
        paths_.push_back(tracking.paths.data() + (member * 3 + axis) * down * across + at);
      }
  }
  const auto sums = [](const Side& side) {
    std::vector<T> all(side.line.coarse, T(0));
    for (std::size_t i = 0; i < side.size.size(); ++i) {
      const T right = T(side.line.share[i]) * side.size[i];
      all[side.line.left[i]] += side.size[i] - right, all[side.line.right[i]] += right;
    }
    return all;
  };
  const std::vector<T> of_rows = sums(rows_), of_cols = sums(cols_);
  for (const T row : of_rows)
    for (const T col : of_cols) weight_.push_back(1 / (row * col));
  lines_.resize(members.size() * rows_.size.size() * 3 * w);
  for (std::vector<T>* field : {&x_, &v_, &past_, &pull_}) field->assign(paths_.size(), T(0));
}

// Which cloth's which row lies in lane `l` of a row of the strips.
template <class T>
typename PullMeans<T>::Lane PullMeans<T>::lane(int row, int l) const {
  const int cloth = strips_.banded ? 0 : l, at = strips_.banded ? l * strips_.rows + row : row;
  const bool there = cloth < int(densities_.size()) && at < int(rows_.size.size());
  return there ? Lane{cloth, at} : Lane{-1, -1};
}

template <class T>
void PullMeans<T>::step(const Fields<T>& f, int k) {
  if (k % held_ == 0) {
    const double later = middle(k, std::min(k + held_, count_ + 1), count_), since = k > held_ ? held_ : held_ - 0.5;
    const T trend = T(k ? (later + 0.5) / since : 0);  // velocities are half a substep old, but at a frame's start
    std::swap(past_, v_);
    mean(f.x, x_), mean(f.v, v_);
    const double s = (k + later) / count_, ahead = later * frame_dt_ / count_;
    for (std::size_t i = 0; i < paths_.size(); ++i)
      pull_[i] = T(tracking_.pull(*paths_[i], s, frame_dt_, x_[i] + ahead * v_[i], v_[i] + trend * (v_[i] - past_[i])));
    spread();
  }
  for (std::ptrdiff_t i = 0; i < strips_.field; ++i) f.slow[i] += force_[i];
}

template <class T>
void PullMeans<T>::mean(const T* field, std::vector<T>& to) {
  const int width = strips_.width, q = 3 * width, w = cols_.line.coarse, h = rows_.line.coarse;
  const int height = int(rows_.size.size());
  std::fill(to.begin(), to.end(), T(0));
  for (int r = 0; r < strips_.rows; ++r) {
    std::fill(row_.begin(), row_.end(), T(0));
    for (int c = 0; c < strips_.cols; ++c) {
      const T* const at = field + strips_.at(r, c);
      T *const left = row_.data() + cols_.line.left[c] * q, *const right = row_.data() + cols_.line.right[c] * q;
      const T b = T(cols_.line.share[c]) * cols_.size[c], a = cols_.size[c] - b;
      for (int i = 0; i < q; ++i) left[i] += a * at[i];
      for (int i = 0; b != 0 && i < q; ++i) right[i] += b * at[i];
    }
    for (int l = 0; l < width; ++l) {
      const auto [cloth, row] = lane(r, l);
      for (int i = 0; cloth >= 0 && i < 3 * w; ++i) lines_[(cloth * height + row) * 3 * w + i] = row_[i * width + l];
    }
  }
  for (int line = 0; line < int(densities_.size()) * height; ++line) {  // in the same order in bands and in lanes
    const int cloth = line / height, row = line % height;
    const T b = T(rows_.line.share[row]) * rows_.size[row], a = rows_.size[row] - b;
    const T* const x = lines_.data() + line * 3 * w;
    T* const left = to.data() + (cloth * h + rows_.line.left[row]) * w * 3;
    T* const right = to.data() + (cloth * h + rows_.line.right[row]) * w * 3;
    for (int i = 0; i < 3 * w; ++i) left[i] += a * x[i];
    for (int i = 0; b != 0 && i < 3 * w; ++i) right[i] += b * x[i];
  }
  for (std::size_t i = 0; i < to.size(); ++i) to[i] *= weight_[i / 3 % weight_.size()];
}

// Forces of what means are accelerated by.
template <class T>
void PullMeans<T>::spread() {
  const int width = strips_.width, q = 3 * width, w = cols_.line.coarse, h = rows_.line.coarse;
  std::fill(row_.begin(), row_.end(), T(0));
  for (int r = 0; r < strips_.rows; ++r) {
    for (int l = 0; l < width; ++l) {
      const auto [cloth, row] = lane(r, l);
      if (cloth < 0) {
        for (int i = 0; i < 3 * w; ++i) row_[i * width + l] = 0;
        continue;
      }
      const T b = T(rows_.line.share[row]), mass = T(densities_[cloth]) * rows_.size[row];
      const T* const left = pull_.data() + (cloth * h + rows_.line.left[row]) * w * 3;
      const T* const right = pull_.data() + (cloth * h + rows_.line.right[row]) * w * 3;
      for (int i = 0; i < 3 * w; ++i) row_[i * width + l] = mass * (left[i] + b * (right[i] - left[i]));
    }
    for (int c = 0; c < strips_.cols; ++c) {
      T* const at = force_.data() + strips_.at(r, c);
      const T *const left = row_.data() + cols_.line.left[c] * q, *const right = row_.data() + cols_.line.right[c] * q;
      const T b = T(cols_.line.share[c]) * cols_.size[c], a = cols_.size[c] - b;
      for (int i = 0; i < q; ++i) at[i] = a * left[i] + b * right[i];
    }
  }
}

template class PullMeans<float>;
template class PullMeans<double>;

}  // namespace minicloth
