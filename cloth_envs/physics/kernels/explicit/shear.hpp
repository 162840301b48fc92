// How far cells are sheared, and how fast neighbours part. Included where it is compiled for an instruction set.
#pragma once
#include <cstddef>
#include <cstring>

#include "../base/simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class W>
inline W larger(const W& a, const W& b) {
  return a > b ? a : b;
}
template <class W>
inline W size(const W& a) {
  return a < 0 ? -a : a;
}

// Of vertices in the lanes of W: at their four corners, what leads down times what leads to the right, added with the
// signs that make most of it: all alike, or other ones above than below, to the left than to the right, or both.
template <class W, class T>
inline W slant(const T* x, std::ptrdiff_t vertices, std::ptrdiff_t cols) {
  W alike = {}, rows = {}, columns = {}, both = {};
  for (int k = 0; k < 3; ++k, x += vertices) {
    W at, up, down, left, right;
    std::memcpy(&at, x, sizeof at);
    std::memcpy(&up, x - cols, sizeof up), std::memcpy(&down, x + cols, sizeof down);
    std::memcpy(&left, x - 1, sizeof left), std::memcpy(&right, x + 1, sizeof right);
    const W twice = at + at, fall = down - up, along = right - left;
    const W sag = (up + down) - twice, bow = (left + right) - twice;
    alike += fall * along, rows += sag * along, columns += fall * bow, both += sag * bow;
  }
  return larger(larger(size(alike), size(rows)), larger(size(columns), size(both)));
}

// Of vertices in the lanes of W: the square of what one has over those that are `to` places before; the largest.
template <class W, class T, class... To>
inline W apart(const T* v, std::ptrdiff_t vertices, To... to) {
  W squares[] = {(void(to), W{})...};
  for (int k = 0; k < 3; ++k, v += vertices) {
    W at, other, *square = squares;
    std::memcpy(&at, v, sizeof at);
    ((std::memcpy(&other, v - to, sizeof other), *square++ += (at - other) * (at - other)), ...);
  }
  W most = squares[0];
  for (const W& square : squares) most = larger(square, most);
  return most;
}

// The largest that is found in rows; NaN does not count. A row's last vector ends with it, over what was seen before;
// rows that are too short for one have short ones.
template <class T>
class Largest {
 public:
  // Of the columns from `c` to `end`: what `of` finds in the lanes of a vector like its first argument.
  template <class Of>
  void look(const T* row, std::ptrdiff_t c, std::ptrdiff_t end, const Of& of) {
    if (end - c >= kLanes<T>)
      run(most_, kLanes<T>, row, c, end, of);
    else if (end - c >= kFew)
      run(some_, kFew, row, c, end, of);
    else
      run(last_, 1, row, c, end, of);
  }
  T found() const {
    T all = last_;
    for (int l = 0; l < kLanes<T>; ++l) all = larger(T(most_[l]), all);
    for (int l = 0; l < kFew; ++l) all = larger(T(some_[l]), all);
    return all;
  }

 private:
  template <class W, class Of>
  static void run(W& most, std::ptrdiff_t n, const T* row, std::ptrdiff_t c, std::ptrdiff_t end, const Of& of) {
    for (; c + n < end; c += n) most = larger(of(most, row + c), most);
    most = larger(of(most, row + (end - n)), most);
  }
  static constexpr int kFew = (sizeof(V<T>) > 32 ? 32 : 16) / int(sizeof(T));
  typedef T Short __attribute__((vector_size(kFew * sizeof(T))));
  V<T> most_ = {};
  Short some_ = {};
  T last_ = 0;
};

// Of the inner vertices of positions (3, H, W) [m^2].
template <class T>
T slant(int height, int width, const T* x) {
  const std::ptrdiff_t rows = height, cols = width;
  Largest<T> largest;
  for (std::ptrdiff_t r = 1; r < rows - 1; ++r)
    largest.look(x + r * cols, 1, cols - 1,
                 [&](auto like, const T* at) { return slant<decltype(like)>(at, rows * cols, cols); });
  return largest.found();
}

// Of the edges along rows and columns, of velocities (3, H, W) [m^2/s^2].
template <class T>
T apart(int height, int width, const T* v) {
  const std::ptrdiff_t rows = height, cols = width;
  Largest<T> largest;
  const auto along = [&](auto like, const T* at) { return apart<decltype(like)>(at, rows * cols, 1); };
  const auto down = [&](auto like, const T* at) { return apart<decltype(like)>(at, rows * cols, cols); };
  const auto both = [&](auto like, const T* at) { return apart<decltype(like)>(at, rows * cols, 1, cols); };
  largest.look(v, 1, cols, along);
  for (std::ptrdiff_t r = 1; r < rows; ++r) {
    largest.look(v + r * cols, 0, 1, down);
    largest.look(v + r * cols, 1, cols, both);
  }
  return largest.found();
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
