#include "near.hpp"

#include <algorithm>

namespace minicloth {

template <class T>
void Sweep<T>::shape(int rows_, int cols_, bool periodic_) {
  if (rows == rows_ && cols == cols_ && periodic == periodic_) return;
  rows = rows_, cols = cols_, periodic = periodic_;
  const auto parts = [](int n) { return (n + kSide - 1) / kSide; };
  block_rows = parts(rows), block_cols = parts(cols);
  group_rows = parts(block_rows), group_cols = parts(block_cols);
  groups = group_rows * group_cols, blocks = groups * kCells;
  plane = padded(rows * cols + 4 * kBlock);
  for (auto* planes : {&x, &v, &normal, &later}) planes->assign(3 * plane, T(0));
  plain.assign(plane, T(0)), even.assign(plane, T(0)), records.assign(kRecord * plane, T(0));
  for (auto* points : {&start, &way}) points->assign(std::size_t(3) * kWide * blocks, T(0));
  box.assign(kBox * blocks, T(0)), cone.assign(6 * blocks, T(0)), group.assign(kBox * padded(groups), T(0));
  shift.assign(4 * blocks, T(0)), slots.assign(std::size_t(kBox) * kCells * blocks, T(0));
  filled.assign(blocks, 0), fresh.assign(blocks, 0), level.assign(blocks, 0);
  row.clear(), col.clear();
  for (auto& c : corner) c.clear();
  for (int i = 0; i < rows * cols; ++i) {
    row.push_back(std::int16_t(i / cols)), col.push_back(std::int16_t(i % cols));
    const int right = col[i] + 1 < cols ? 1 : periodic ? 1 - cols : 0, down = row[i] + 1 < rows ? cols : 0;
    corner[0].push_back(i), corner[1].push_back(i + right);
    corner[2].push_back(i + down), corner[3].push_back(i + right + down);
  }
  at.assign(blocks, -1), point.assign(std::size_t(kWide) * blocks, 0), exists.assign(blocks, 0);
  for (int b = 0; b < blocks; ++b) {
    const int g = b / kCells, i = b % kCells;
    const int r0 = (g / group_cols * kSide + i / kSide) * kSide, c0 = (g % group_cols * kSide + i % kSide) * kSide;
    if (r0 >= rows || c0 >= cols) continue;
    at[b] = r0 * cols + c0;
    for (int k = 0; k < kCells; ++k)
      if (r0 + k / kSide < rows && c0 + k % kSide < cols) exists[b] |= std::uint16_t(1 << k);
    for (int k = 0; k < kWide; ++k) {
      const int j = std::min(k, kPoints - 1), r = std::min(r0 + j / (kSide + 1), rows - 1), c = c0 + j % (kSide + 1);
      point[kWide * b + k] = r * cols + (periodic ? std::min(c, cols) % cols : std::min(c, cols - 1));
    }
  }
}

template struct Sweep<float>;
template struct Sweep<double>;

}  // namespace minicloth
