// Which cells may meet. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "meet_boxes.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Which of a vector of boxes, planes `stride` apart, meet a box whose numbers are `step` apart.
inline unsigned meet(const float* a, std::size_t step, const float* b, std::size_t stride) {
  unsigned found = ~0u;
  for (int k = 0; k < 3; ++k)
    found &= less<float>(load(b + k * stride), F{} + (a[(3 + k) * step] + kNear)) &
             less<float>(F{} + (a[k * step] - kNear), load(b + (3 + k) * stride));
  return found;
}

// Whether blocks beside each other, or one alone, are so flat that their cells do not meet.
bool flat(const Meeting& m, int a, int b) {
  float length = 0, spread = 0, axis[3];
  for (int k = 0; k < 3; ++k) {
    const float *const low = m.cone.data() + k * m.blocks, *const high = low + 3 * m.blocks;
    const float lo = std::min(low[a], low[b]), hi = std::max(high[a], high[b]);
    axis[k] = (lo + hi) / 2, length += axis[k] * axis[k], spread += (hi - lo) * (hi - lo) / 4;
  }
  const float flat = float(kFlat) * m.twice / 2;
  if (length > 2 * (flat * flat + spread)) return true;  // as below, without roots
  length = std::sqrt(length);
  if (length - std::sqrt(spread) > flat) return true;
  if (length < flat) return false;
  for (const int block : {a, b}) {
    const int r0 = block / m.block_cols * kSide, c0 = block % m.block_cols * kSide;
    const unsigned real = (1u << std::min(kSide, m.across - c0)) - 1;
    for (int r = r0; r < std::min(r0 + kSide, m.down); ++r) {
      const auto along = [&](const Plane<float>& normals) -> F {
        const float* const x = normals.data() + r * m.stride + 1 + c0;
        return axis[0] * load(x) + axis[1] * load(x + m.plane) + axis[2] * load(x + 2 * m.plane);
      };
      const F lower = along(m.lower);
      if (less<float>(least(lower, along(m.normal) - lower), F{} + flat * length) & real) return false;
    }
  }
  return true;
}

// The boxes of a block's cells side by side, empty where there are none.
const float* slots(Meeting& m, int block) {
  float* const to = m.slots.data() + std::size_t(block) * 6 * kCells;
  if (m.filled[block]) return to;
  m.filled[block] = 1;
  const int r0 = block / m.block_cols * kSide, rows = std::min(kSide, m.down - r0);
  const int c0 = block % m.block_cols * kSide, cols = std::min(kSide, m.across - c0);
  unsigned level = 0, moves = 0;
  for (int r = 0; r < kSide; ++r) {
    const std::size_t first = std::size_t(r0 + r) * m.stride + 1 + c0;
    for (int k = 0; k < 6; ++k) {
      float* const four = to + k * kCells + r * kSide;
      const Plane<float>& from = k < 3 ? m.low : m.high;
      for (int c = 0; c < kSide; ++c) four[c] = r < rows ? from[k % 3 * m.plane + first + c] : (k < 3 ? kNone : -kNone);
    }
    for (int c = 0; r < rows && c < cols; ++c) {
      const float *const top = m.moved.data() + first + c, *const below = top + m.stride;
      level |= unsigned(m.even[first + c] > 0) << (r * kSide + c);
      moves |= unsigned(top[0] + top[1] + below[0] + below[1] > 0) << (r * kSide + c);
    }
  }
  m.level[block] = std::uint16_t(level), m.moves[block] = std::uint16_t(moves);
  return to;
}

// Cells of two blocks whose boxes meet, the second dr rows and dc columns of blocks further; those of one block once.
void look_into(Meeting& m, int a, int b, int dr, int dc) {
  static const Around around;
  const float *const first = slots(m, a), *const second = slots(m, b);
  unsigned some = 0, those = 0;
  for (int k = 0; k < kCells; k += n) some |= meet(m.box.data() + b, m.blocks, first + k, kCells) << k;
  if (!some) return;
  for (int k = 0; k < kCells; k += n) those |= meet(m.box.data() + a, m.blocks, second + k, kCells) << k;
  if (!those) return;
  const auto cell = [&](int block, int i) {
    return (block / m.block_cols * kSide + i / kSide) * m.stride + 1 + block % m.block_cols * kSide + i % kSide;
  };
  const bool beside = std::abs(dr) <= 1 && std::abs(dc) <= 1;
  for (; some; some &= some - 1) {
    const int i = __builtin_ctz(some);
    unsigned wanted = m.moves[a] >> i & 1 ? those : those & m.moves[b];
    if (a == b) wanted &= ~0u << (i + 1);
    if (beside && m.level[a] >> i & 1) wanted &= ~unsigned(around.cells[dr + 1][dc + 1][i] & m.level[b]);
    if (!wanted) continue;
    unsigned found = 0;
    for (int k = 0; k < kCells; k += n) found |= meet(first + i, kCells, second + k, kCells) << k;
    for (found &= wanted; found; found &= found - 1)
      m.pairs[0].push_back(cell(a, i)), m.pairs[1].push_back(cell(b, __builtin_ctz(found)));
  }
}

// Cells of all blocks whose boxes meet. Beside the last blocks of a closed sheet, if they are narrower than others,
// nothing is left out.
void blocks(Meeting& m) {
  const std::size_t most = std::size_t(kCrowded) * m.rows * m.cols;
  const int strips = padded(m.strips);
  const bool closes = m.periodic && m.across % kSide == 0 && m.block_cols > 2;
  thread_local std::vector<char> some_fresh;
  some_fresh.assign(m.strips, 0);
  for (int b = 0; b < m.blocks; ++b) some_fresh[b / kBlock] |= m.fresh[b];
  for (int a = 0; a < m.block_rows * m.block_cols; ++a) {
    if (m.pairs[0].size() > most) return m.pairs[0].clear(), m.pairs[1].clear();  // it blew up
    for (int from = a / kBlock / n * n; from < m.strips; from += n)
      for (unsigned some = meet(m.box.data() + a, m.blocks, m.strip.data() + from, strips); some; some &= some - 1) {
        const int strip = from + __builtin_ctz(some);
        if (strip < a / kBlock || strip >= m.strips || !(m.fresh[a] | some_fresh[strip])) continue;
        for (int k = strip * kBlock; k < (strip + 1) * kBlock; k += n)
          for (unsigned found = meet(m.box.data() + a, m.blocks, m.box.data() + k, m.blocks); found;
               found &= found - 1) {
            const int b = k + __builtin_ctz(found);
            if (b < a || !(m.fresh[a] | m.fresh[b])) continue;
            const int dr = b / m.block_cols - a / m.block_cols;
            int dc = b % m.block_cols - a % m.block_cols;
            if (closes && std::abs(dc) == m.block_cols - 1) dc = dc > 0 ? -1 : 1;
            if (dr <= 1 && std::abs(dc) <= 1 && flat(m, a, b)) continue;
            look_into(m, a, b, dr, dc);
          }
      }
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
