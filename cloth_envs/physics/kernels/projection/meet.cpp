#include "meet.hpp"

#include <algorithm>

namespace minicloth {

void Meeting::shape(int rows_, int cols_, bool periodic_, double cell_area) {
  twice = float(2 * cell_area);
  if (rows == rows_ && cols == cols_ && periodic == periodic_) return;
  rows = rows_, cols = cols_, periodic = periodic_;
  down = rows - 1, across = periodic ? cols : cols - 1;
  block_rows = (down + kSide - 1) / kSide, block_cols = (across + kSide - 1) / kSide;
  blocks = padded(block_rows * block_cols), strips = blocks / kBlock;
  stride = padded(across) + kBlock, plane = std::size_t(stride) * rows + 2 * kBlock;
  number.assign(plane, 0);
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c <= across; ++c) number[r * stride + 1 + c] = r * cols + c % cols;
  for (auto* planes : {&x, &low, &high, &normal, &lower}) planes->assign(3 * plane, 0.0f);
  for (auto* numbers : {&moved, &plain, &even}) numbers->assign(plane, 0.0f);
  for (auto* boxes : {&box, &cone}) boxes->assign(std::size_t(6) * blocks, 0.0f);
  strip.assign(std::size_t(6) * padded(strips), 0.0f), slots.assign(std::size_t(6) * kCells * blocks, 0.0f);
  fresh.assign(blocks, 0), filled.assign(blocks, 0), level.assign(blocks, 0), moves.assign(blocks, 0);
  fresh_rows.assign(block_rows, 0);
}

}  // namespace minicloth
