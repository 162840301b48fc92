#include "near.hpp"

namespace minicloth {

template <class T>
void Sweep<T>::shape(int rows_, int cols_, bool periodic_) {
  if (rows == rows_ && cols == cols_ && periodic == periodic_) return;
  rows = rows_, cols = cols_, periodic = periodic_;
  const auto parts = [](int n) { return (n + kSide - 1) / kSide; };
  block_rows = parts(rows), block_cols = parts(cols);
  group_rows = parts(block_rows), group_cols = parts(block_cols);
  groups = group_rows * group_cols, blocks = groups * kCells;
  plane = padded(rows * cols + 2 * kBlock);
  for (auto* planes : {&now, &then, &normal}) planes->assign(3 * plane, T(0));
  even.assign(plane, T(0)), slack.assign(plane, T(0)), records.assign(kRecord * plane, T(0));
  box.assign(kBox * blocks, T(0)), cone.assign(6 * blocks, T(0)), group.assign(kBox * padded(groups), T(0));
  slots.assign(std::size_t(kBox) * kCells * blocks, T(0));
  room.assign(blocks, T(0)), filled.assign(blocks, 0), fresh.assign(blocks, 1), level.assign(blocks, 0), at.assign(blocks, -1);
  for (int b = 0; b < blocks; ++b) {
    const int g = b / kCells, i = b % kCells;
    const int r = g / group_cols * kSide + i / kSide, c = g % group_cols * kSide + i % kSide;
    if (r < block_rows && c < block_cols) at[b] = r * kSide * cols + c * kSide;
  }
  row.clear(), col.clear();
  for (auto& c : corner) c.clear();
  for (int i = 0; i < rows * cols; ++i) {
    row.push_back(std::int16_t(i / cols)), col.push_back(std::int16_t(i % cols));
    const int right = col[i] + 1 < cols ? 1 : periodic ? 1 - cols : 0, down = row[i] + 1 < rows ? cols : 0;
    corner[0].push_back(i), corner[1].push_back(i + right);
    corner[2].push_back(i + down), corner[3].push_back(i + right + down);
  }
}

template struct Sweep<float>;
template struct Sweep<double>;

}  // namespace minicloth
