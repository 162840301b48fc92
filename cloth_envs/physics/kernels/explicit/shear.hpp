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
  return larger(a, -a);
}

// Of vertices in the lanes of W: at their four corners, what leads down times what leads to the right, added with the
// signs that make most of it: all alike, or other ones above than below, to the left than to the right, or both.
template <class W, class T>
inline W slant(const T* x, std::ptrdiff_t vertices, std::ptrdiff_t cols) {
  W corners[2][2] = {};  // above and below, to the left and to the right
  for (int k = 0; k < 3; ++k, x += vertices) {
    W at, up, down, left, right;
    std::memcpy(&at, x, sizeof at);
    std::memcpy(&up, x - cols, sizeof up), std::memcpy(&down, x + cols, sizeof down);
    std::memcpy(&left, x - 1, sizeof left), std::memcpy(&right, x + 1, sizeof right);
    const W fall[2] = {at - up, down - at}, along[2] = {at - left, right - at};
    for (int i = 0; i < 2; ++i)
      for (int j = 0; j < 2; ++j) corners[i][j] += fall[i] * along[j];
  }
  const auto both = [](const W& above, const W& below) { return size(above) + size(below); };
  return larger(both(corners[0][0] + corners[0][1], corners[1][0] + corners[1][1]),
                both(corners[0][0] - corners[0][1], corners[1][0] - corners[1][1]));
}

// Of vertices in the lanes of W: the square of what one has over that `to` places before.
template <class W, class T>
inline W apart(const T* v, std::ptrdiff_t vertices, std::ptrdiff_t to) {
  W sum = {};
  for (int k = 0; k < 3; ++k, v += vertices) {
    W at, before;
    std::memcpy(&at, v, sizeof at), std::memcpy(&before, v - to, sizeof before);
    sum += (at - before) * (at - before);
  }
  return sum;
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
  const auto over = [&](std::ptrdiff_t to) {
    return [&, to](auto like, const T* at) { return apart<decltype(like)>(at, rows * cols, to); };
  };
  for (std::ptrdiff_t r = 0; r < rows; ++r) largest.look(v + r * cols, 1, cols, over(1));
  largest.look(v, cols, rows * cols, over(cols));  // rows lie one after the other
  return largest.found();
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
