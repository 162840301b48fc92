// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>

#include "../base/simd.hpp"
#include "meet.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int n = kLanes<float>;
constexpr float kNone = 1e9f;    // m
constexpr float kNear = 1e-6f;   // m, so near are boxes that meet
constexpr float kRound = 4e-6f;  // of the distance of a plane, and more than rounding may take
constexpr float kSmall = 0.3f;   // of the rest area, of cells whose normals tell little
constexpr float kLevel = 0.2f;   // least cosine between neighbours' normals where cells up to kApart apart do not meet
constexpr float kPlain = 0.8f;   // the same of a cell's two triangles
constexpr float kFlat = 0.35f;   // least part of the rest area that cells of flat blocks have along a common normal
constexpr int kApart = 2;

inline F least(const F& a, const F& b) { return a < b ? a : b; }
inline F most(const F& a, const F& b) { return a > b ? a : b; }

// The positions, and which blocks have vertices that moved.
void take(Meeting& m, const float* x, bool all) {
  for (int r = 0; r < m.rows; ++r)
    for (int k = 0; k < 3; ++k) {
      const float* const from = x + (std::size_t(k) * m.rows + r) * m.cols;
      float *const to = m.x.data() + k * m.plane + r * m.stride + 1, *const moved = m.moved.data() + r * m.stride + 1;
      for (int c = 0; c < m.cols; ++c) moved[c] = all ? 1.0f : (k ? moved[c] : 0.0f) + (to[c] != from[c] ? 1.0f : 0.0f);
      std::memcpy(to, from, m.cols * sizeof(float));
      if (m.periodic) to[m.cols] = to[0], moved[m.cols] = moved[0];
    }
  std::fill(m.fresh.begin(), m.fresh.end(), all), std::fill(m.fresh_rows.begin(), m.fresh_rows.end(), all);
  for (int b = 0; !all && b < m.block_rows * m.block_cols; ++b) {
    const int r0 = b / m.block_cols * kBlockSide, c0 = b % m.block_cols * kBlockSide;
    float moved = 0;
    for (int r = r0; r <= std::min(r0 + kBlockSide, m.rows - 1); ++r)
      for (int c = c0; c <= std::min(c0 + kBlockSide, m.across); ++c) moved += m.moved[r * m.stride + 1 + c];
    m.fresh[b] = moved > 0, m.fresh_rows[b / m.block_cols] |= m.fresh[b];
  }
}

// Boxes and normals of a row of cells.
void cells_of(Meeting& m, int r) {
  const std::size_t row = std::size_t(r) * m.stride + 1;
  for (int c = 0; c < m.across; c += n) {
    const std::size_t i = row + c;
    V3<float> p[4];
    float* const to[3] = {m.x.data() + i, m.x.data() + m.plane + i, m.x.data() + 2 * m.plane + i};
    for (int q = 0; q < 4; ++q) p[q] = at<float>(to, q % 2 + q / 2 * m.stride);
    const auto bounds = [&](int k, const F& a, const F& b, const F& d, const F& e) {
      store<float>(m.low.data() + k * m.plane + i, least(least(a, b), least(d, e)));
      store<float>(m.high.data() + k * m.plane + i, most(most(a, b), most(d, e)));
    };
    bounds(0, p[0].x, p[1].x, p[2].x, p[3].x), bounds(1, p[0].y, p[1].y, p[2].y, p[3].y);
    bounds(2, p[0].z, p[1].z, p[2].z, p[3].z);
    const V3<float> a = p[3] - p[0], sum = cross(a, p[1] - p[2]), one = cross(p[2] - p[0], a), other = sum - one;
    float* const normal[3] = {m.normal.data() + i, m.normal.data() + m.plane + i, m.normal.data() + 2 * m.plane + i};
    put<float>(normal, 0, sum);
    const F d = dot(one, other), yes = F{} + 1.0f;
    const auto level = (d > 0.0f) & (d * d > kPlain * kPlain * dot(one, one) * dot(other, other));
    store<float>(m.plain.data() + i, level ? yes : -yes);
  }
  // Beside a sheet that ends its last cells are repeated, and there is nothing.
  const int last = m.across - 1;
  for (int k = 0; k < 3; ++k) {
    float *const low = m.low.data() + k * m.plane + row, *const high = m.high.data() + k * m.plane + row;
    float* const normal = m.normal.data() + k * m.plane + row;
    for (int c = m.across; c < kBlockSide * m.block_cols; ++c) low[c] = kNone, high[c] = -kNone;
    normal[-1] = normal[m.periodic ? last : 0], normal[m.across] = normal[m.periodic ? 0 : last];
  }
}

// Whether cells are plain and level with those beside them.
void evenness(Meeting& m, int r) {
  const int up = r > 0 ? -m.stride : 0, below = r + 1 < m.down ? m.stride : 0;
  const float *const x = m.normal.data() + std::size_t(r) * m.stride + 1, *const y = x + m.plane,
                     *const z = y + m.plane;
  const float small = (kSmall * m.twice) * (kSmall * m.twice);
  for (int c = 0; c < m.across; c += n) {
    const auto get = [&](int by) -> V3<float> { return {load(x + c + by), load(y + c + by), load(z + c + by)}; };
    const V3<float> own = get(0);
    const F own2 = dot(own, own);
    auto even = (load(m.plain.data() + std::size_t(r) * m.stride + 1 + c) > 0.0f) & (own2 > small);
    for (const int by : {-1, 1, up, below}) {
      const V3<float> other = get(by);
      const F d = dot(own, other), other2 = dot(other, other);
      even &= (other2 > small) & (d > 0.0f) & (d * d > kLevel * kLevel * own2 * other2);
    }
    const F yes = F{} + 1.0f;
    store<float>(m.even.data() + std::size_t(r) * m.stride + 1 + c, even ? yes : -yes);
  }
}

// The least or the most of the cells of a row of blocks.
template <bool low>
void reduce(const Meeting& m, const float* plane, int rows, int across, float* to) {
  const auto better = [](const auto& a, const auto& b) { return low ? (a < b ? a : b) : (a > b ? a : b); };
  for (int c = 0; c < m.block_cols; c += n / kBlockSide) {
    F v = load(plane + kBlockSide * c);
    for (int r = 1; r < rows; ++r) v = better(v, load(plane + r * m.stride + kBlockSide * c));
    alignas(64) float all[n];
    store<float>(all, v);
    for (int b = 0; b < n / kBlockSide && c + b < m.block_cols; ++b) {
      const float* const four = all + kBlockSide * b;
      float found = four[0];
      for (int i = 1; i < std::min(kBlockSide, across - kBlockSide * (c + b)); ++i) found = better(found, four[i]);
      to[c + b] = found;
    }
  }
}

// Of blocks and strips, from cells of the rows where something is fresh.
void boxes(Meeting& m) {
  for (int b = 0; b < m.block_rows; ++b) {
    if (!m.fresh_rows[b]) continue;
    const std::size_t first = std::size_t(b) * kBlockSide * m.stride + 1;
    const int rows = std::min(kBlockSide, m.down - kBlockSide * b);
    for (int k = 0; k < 3; ++k) {
      float *const box = m.box.data() + k * m.blocks + b * m.block_cols, *const cone =
                                                                             m.cone.data() + (box - m.box.data());
      reduce<true>(m, m.low.data() + k * m.plane + first, rows, m.across, box);
      reduce<false>(m, m.high.data() + k * m.plane + first, rows, m.across, box + 3 * m.blocks);
      reduce<true>(m, m.normal.data() + k * m.plane + first, rows, m.across, cone);
      reduce<false>(m, m.normal.data() + k * m.plane + first, rows, m.across, cone + 3 * m.blocks);
    }
  }
  for (int b = m.block_rows * m.block_cols; b < m.blocks; ++b)
    for (int k = 0; k < 6; ++k) m.box[k * m.blocks + b] = k < 3 ? kNone : -kNone;
  const int strips = padded(m.strips);
  for (int k = 0; k < 6; ++k)
    for (int s = 0; s < m.strips; ++s) {
      const float *const first = m.box.data() + k * m.blocks + s * kBlock, *const end = first + kBlock;
      m.strip[k * strips + s] = k < 3 ? *std::min_element(first, end) : *std::max_element(first, end);
    }
}

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
  const float flat = kFlat * m.twice;
  length = std::sqrt(length);
  if (length - std::sqrt(spread) > flat) return true;
  if (length < flat) return false;
  for (const int block : {a, b}) {
    const int r0 = block / m.block_cols * kBlockSide, c0 = block % m.block_cols * kBlockSide;
    const unsigned real = (1u << std::min(kBlockSide, m.across - c0)) - 1;
    for (int r = r0; r < std::min(r0 + kBlockSide, m.down); ++r) {
      const float* const normal = m.normal.data() + r * m.stride + 1 + c0;
      const F along = axis[0] * load(normal) + axis[1] * load(normal + m.plane) + axis[2] * load(normal + 2 * m.plane);
      if (less<float>(along, F{} + flat * length) & real) return false;
    }
  }
  return true;
}

// The boxes of a block's cells side by side, empty where there are none.
const float* slots(Meeting& m, int block) {
  float* const to = m.slots.data() + std::size_t(block) * 6 * kBlockCells;
  if (m.filled[block]) return to;
  m.filled[block] = 1;
  const int r0 = block / m.block_cols * kBlockSide, rows = std::min(kBlockSide, m.down - r0);
  const int c0 = block % m.block_cols * kBlockSide, cols = std::min(kBlockSide, m.across - c0);
  unsigned level = 0, moves = 0;
  for (int r = 0; r < kBlockSide; ++r) {
    const std::size_t first = std::size_t(r0 + r) * m.stride + 1 + c0;
    for (int k = 0; k < 6; ++k) {
      float* const four = to + k * kBlockCells + r * kBlockSide;
      const Plane<float>& from = k < 3 ? m.low : m.high;
      for (int c = 0; c < kBlockSide; ++c)
        four[c] = r < rows ? from[k % 3 * m.plane + first + c] : (k < 3 ? kNone : -kNone);
    }
    for (int c = 0; r < rows && c < cols; ++c) {
      const float *const top = m.moved.data() + first + c, *const below = top + m.stride;
      level |= unsigned(m.even[first + c] > 0) << (r * kBlockSide + c);
      moves |= unsigned(top[0] + top[1] + below[0] + below[1] > 0) << (r * kBlockSide + c);
    }
  }
  m.level[block] = std::uint16_t(level), m.moves[block] = std::uint16_t(moves);
  return to;
}

// Of cell i of a block, the cells up to kApart apart in the block dr - 1, dc - 1 blocks further.
struct Around {
  std::uint16_t cells[3][3][kBlockCells] = {};
  Around() {
    for (int block = 0; block < 9; ++block)
      for (int i = 0; i < kBlockCells; ++i)
        for (int j = 0; j < kBlockCells; ++j) {
          const int r = (block / 3 - 1) * kBlockSide + j / kBlockSide - i / kBlockSide,
                    c = (block % 3 - 1) * kBlockSide + j % kBlockSide - i % kBlockSide;
          const bool near = std::abs(r) <= kApart && std::abs(c) <= kApart;
          cells[block / 3][block % 3][i] |= std::uint16_t(near << j);
        }
  }
};

// Cells of two blocks whose boxes meet; those of one block once. A sheet that is closed may have a last block of a
// width of its own, beside which nothing is left out.
void look_into(Meeting& m, int a, int b, int dr, int dc) {
  static const Around around;
  const float *const first = slots(m, a), *const second = slots(m, b);
  unsigned some = 0, those = 0;
  for (int k = 0; k < kBlockCells; k += n) some |= meet(m.box.data() + b, m.blocks, first + k, kBlockCells) << k;
  if (!some) return;
  for (int k = 0; k < kBlockCells; k += n) those |= meet(m.box.data() + a, m.blocks, second + k, kBlockCells) << k;
  if (!those) return;
  const auto cell = [&](int block, int i) {
    return (block / m.block_cols * kBlockSide + i / kBlockSide) * m.stride + 1 + block % m.block_cols * kBlockSide +
           i % kBlockSide;
  };
  const bool beside = std::abs(dr) <= 1 && std::abs(dc) <= 1;
  for (; some; some &= some - 1) {
    const int i = __builtin_ctz(some);
    unsigned wanted = m.moves[a] >> i & 1 ? those : those & m.moves[b];
    if (a == b) wanted &= ~0u << (i + 1);
    if (beside && m.level[a] >> i & 1) wanted &= ~unsigned(around.cells[dr + 1][dc + 1][i] & m.level[b]);
    if (!wanted) continue;
    unsigned found = 0;
    for (int k = 0; k < kBlockCells; k += n) found |= meet(first + i, kBlockCells, second + k, kBlockCells) << k;
    for (found &= wanted; found; found &= found - 1)
      m.pairs[0].push_back(cell(a, i)), m.pairs[1].push_back(cell(b, __builtin_ctz(found)));
  }
}

void blocks(Meeting& m) {
  const int strips = padded(m.strips);
  const bool closes = m.periodic && m.across % kBlockSide == 0 && m.block_cols > 2;
  thread_local std::vector<char> some_fresh;
  some_fresh.assign(m.strips, 0);
  for (int b = 0; b < m.blocks; ++b) some_fresh[b / kBlock] |= m.fresh[b];
  for (int a = 0; a < m.block_rows * m.block_cols; ++a)
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

// Of triangles of a cell, the planes; which of the other's triangles lie on either side of each: bits 2 i + j.
using Mask = decltype(F{} < F{});
struct Sides {
  Mask apart[2][2];  // [triangle of the cell][of the other]
};
inline Sides sides(const V3<float> (&p)[4], const V3<float> (&q)[4]) {
  Sides to;
  const V3<float> diagonal = p[3] - p[0], down = p[2] - p[0], right = p[1] - p[0];
  const F size = most(dot(diagonal, diagonal), most(dot(down, down), dot(right, right)));
  V3<float> d[4];
  F far = {};
  for (int k = 0; k < 4; ++k) d[k] = q[k] - p[0], far = most(far, dot(d[k], d[k]));
  far += tiny<float>;
  const F margin = kRound * size * (far * rsqrt(far));
  for (int i = 0; i < 2; ++i) {
    const V3<float> normal = i ? cross(diagonal, right) : cross(down, diagonal);
    F h[4];
    for (int k = 0; k < 4; ++k) h[k] = dot(normal, d[k]);
    for (int j = 0; j < 2; ++j) {
      const F low = least(least(h[0], h[3]), h[j ? 1 : 2]), high = most(most(h[0], h[3]), h[j ? 1 : 2]);
      to.apart[i][j] = (low > margin) | (high < -margin);
    }
  }
  return to;
}

// Where triangle i of a cell and triangle j of one that is `step` elements further have a vertex in common.
inline Mask common(const Mask& step, int stride, int i, int j) {
  const int a[3] = {0, stride + 1, i ? 1 : stride}, b[3] = {0, stride + 1, j ? 1 : stride};
  Mask found = {};
  for (int k = 0; k < 9; ++k) found |= step == a[k / 3] - b[k % 3];
  return found;
}

// Which triangles of the pairs of cells have no vertex in common and are not on one side of each other's planes.
void triangles(Meeting& m) {
  const int count = int(m.pairs[0].size());
  for (auto& pairs : m.pairs) pairs.resize(count + n, count ? pairs[0] : 0);
  for (int first = 0; first < count; first += n) {
    V3<float> p[2][4];
    for (int half = 0; half < 2; ++half)
      for (int q = 0; q < 4; ++q) {
        const float* const x = m.x.data() + q % 2 + q / 2 * m.stride;
        const int* const cells = m.pairs[half].data() + first;
        p[half][q] = {gather<float>(x, cells), gather<float>(x + m.plane, cells),
                      gather<float>(x + 2 * m.plane, cells)};
      }
    const Sides one = sides(p[0], p[1]), other = sides(p[1], p[0]);
    Mask from, to;
    std::memcpy(&from, m.pairs[0].data() + first, sizeof from), std::memcpy(&to, m.pairs[1].data() + first, sizeof to);
    unsigned may[2][2], some = 0;
    for (int i = 0; i < 2; ++i)
      for (int j = 0; j < 2; ++j) {
        const Mask apart = one.apart[i][j] | other.apart[j][i] | common(to - from, m.stride, i, j);
        some |= may[i][j] = less<float>(apart ? F{} + 1.0f : F{}, F{} + 0.5f);
      }
    for (; some; some &= some - 1) {
      const int l = __builtin_ctz(some);
      if (first + l >= count) break;
      const auto bit = [&](int i, int j) { return (may[i][j] >> l & 1) << (2 * i + j); };
      m.cells.push_back({m.pairs[0][first + l], m.pairs[1][first + l], bit(0, 0) | bit(0, 1) | bit(1, 0) | bit(1, 1)});
    }
  }
}

void find(Meeting& m, const float* x, bool all) {
  take(m, x, all);
  const auto fresh = [&](int r) { return m.fresh_rows[r / kBlockSide]; };
  for (int r = 0; r < m.down; ++r)
    if (fresh(r)) cells_of(m, r);
  for (int r = 0; r < m.down; ++r)
    if (fresh(std::max(r - 1, 0)) | fresh(std::min(r + 1, m.down - 1))) evenness(m, r);
  boxes(m);
  std::fill(m.filled.begin(), m.filled.end(), 0);
  for (auto& pairs : m.pairs) pairs.clear();
  m.cells.clear();
  blocks(m);
  triangles(m);
}

constexpr MeetLanes instance = {find};

}  // namespace
}  // namespace LANES

DEFINE_LANES(MeetLanes, instance)

}  // namespace minicloth
