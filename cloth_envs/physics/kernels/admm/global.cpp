// The global step of P-ADMM: products with the grid's modes, and what keeps the held vertices.
#include <algorithm>
#include <cmath>

#include "work.hpp"

namespace minicloth {

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
System<T> Admm<T>::system(const Material& material, const double* eigenvalues, const double* capacitance) const {
  const int p = int(sheet_.handles.size()), line = padded(p);
  System<T> out{material, Plane<T>(std::size_t(rows_.n) * line_, T(0)), Plane<T>(std::size_t(3 * p) * line, T(0))};
  for (int k = 0; k < rows_.n; ++k)
    for (int l = 0; l < cols_.n; ++l) out.inverse[k * line_ + l] = T(1 / eigenvalues[k * cols_.n + l]);
  for (int i = 0; i < 3 * p; ++i) std::copy_n(capacitance + i * p, p, out.capacitance.begin() + i * line);
  return out;
}

// Takes from the modes in `second` what moves the held vertices: second -= A^-1 S C^-1 S^T second.
template <class T>
void Admm<T>::hold(const System<T>& system, AdmmWork<T>& w) const {
  const auto multiply = lanes<AdmmLanes<T>>().multiply;
  const int rows = rows_.n, cols = cols_.n, p = int(sheet_.handles.size()), line = padded(p);
  const int distinct = int(held_rows_.size());
  multiply(distinct, rows, width_, held_basis_.data(), rows, 1, w.second.data(), width_, w.held_lines.data(), width_);
  for (int i = 0; i < p; ++i)
    for (int k = 0; k < 3; ++k) {
      const T* at = w.held_lines.data() + held_row_of_[i] * width_ + k * line_;
      const T* basis = cols_.all.data() + sheet_.handles[i] % cols * cols;
      T sum = 0;
      for (int l = 0; l < cols; ++l) sum += at[l] * basis[l];
      w.held[k * line + i] = sum;
    }
  for (int k = 0; k < 3; ++k)
    multiply(1, p, line, w.held.data() + k * line, line, 1, system.capacitance.data() + k * p * line, line,
             w.pull.data() + k * line, line);
  std::fill(w.held_lines.begin(), w.held_lines.end(), T(0));
  for (int i = 0; i < p; ++i)
    for (int k = 0; k < 3; ++k) {
      T* at = w.held_lines.data() + held_row_of_[i] * width_ + k * line_;
      const T* basis = cols_.all.data() + sheet_.handles[i] % cols * cols;
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
void Admm<T>::correct(const System<T>& system, AdmmWork<T>& w, T* const (&out)[3]) const {
  const Geometry<T>& g = geometry_;
  const auto multiply = lanes<AdmmLanes<T>>().multiply;
  const int rows = rows_.n, cols = cols_.n, re = rows_.even, ro = rows_.odd, ce = cols_.even, co = cols_.odd;
  for (std::size_t i = 0; i < sheet_.handles.size(); ++i)
    for (T* plane : w.residual)
      if (std::isinf(sheet_.hold[3 * i])) plane[g.at(sheet_.handles[i])] = 0;
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
  if (!sheet_.handles.empty()) hold(system, w);
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
      T* x = out[k] + g.at(r, 0);
      for (int c = 0; c < co; ++c) x[c] += even[c] + odd[c], x[cols - 1 - c] += even[c] - odd[c];
      if (ce > co) x[co] += even[co];
    }
  }
}

template <class T>
void Admm<T>::solve(const System<T>& system, const T* right, T* x) const {
  AdmmWork<T>& w = scratch();
  const Geometry<T>& g = geometry_;
  g.pad(right, w.residual);
  for (T* plane : w.x) std::fill_n(plane, g.size, T(0));
  correct(system, w, w.x);
  for (std::size_t i = 0; i < sheet_.handles.size(); ++i)
    for (T* plane : w.x)
      if (std::isinf(sheet_.hold[3 * i])) plane[g.at(sheet_.handles[i])] = 0;
  g.unpad(w.x, x);
}

template struct Fold<float>;
template struct Fold<double>;
template System<float> Admm<float>::system(const Material&, const double*, const double*) const;
template System<double> Admm<double>::system(const Material&, const double*, const double*) const;
template void Admm<float>::correct(const System<float>&, AdmmWork<float>&, float* const (&)[3]) const;
template void Admm<double>::correct(const System<double>&, AdmmWork<double>&, double* const (&)[3]) const;
template void Admm<float>::solve(const System<float>&, const float*, float*) const;
template void Admm<double>::solve(const System<double>&, const double*, double*) const;

}  // namespace minicloth
