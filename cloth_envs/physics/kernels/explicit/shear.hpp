// How far cells are sheared. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>
#include <cstring>

#include "../base/simd.hpp"
#include "../sheet/sheet.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Squares of the cosine between what leads from the vertex above to that below and from that on the left to that on the
// right, in the lanes of W.
template <class W, class T>
inline W square_cosine(const T* x, std::ptrdiff_t vertices, std::ptrdiff_t cols) {
  W ab = {}, aa = {}, bb = {};
  for (int k = 0; k < 3; ++k, x += vertices) {
    W ends[4];
    std::memcpy(&ends[0], x - cols, sizeof(W)), std::memcpy(&ends[1], x + cols, sizeof(W));
    std::memcpy(&ends[2], x - 1, sizeof(W)), std::memcpy(&ends[3], x + 1, sizeof(W));
    const W a = ends[1] - ends[0], b = ends[3] - ends[2];
    ab += a * b, aa += a * a, bb += b * b;
  }
  return ab * ab / (aa * bb);
}

// The largest of the inner vertices of positions (3, H, W); NaN does not count.
template <class T>
T shear(const Sheet& sheet, const T* x) {
  constexpr int n = kLanes<T>;
  const std::ptrdiff_t rows = sheet.rows, cols = sheet.cols;
  V<T> most = {};
  T last = 0;
  for (std::ptrdiff_t r = 1; r < rows - 1; ++r) {
    std::ptrdiff_t c = 1;
    for (; c + n < cols; c += n) {
      const V<T> found = square_cosine<V<T>>(x + r * cols + c, rows * cols, cols);
      most = found > most ? found : most;
    }
    for (; c < cols - 1; ++c) {
      const T found = square_cosine<T>(x + r * cols + c, rows * cols, cols);
      last = found > last ? found : last;
    }
  }
  for (int l = 0; l < n; ++l) last = std::max(last, T(most[l]));
  return last;
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
