// Boxes and normals of cells and blocks. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>
#include <cstring>

#include "../base/simd.hpp"
#include "../selfcontact/even.hpp"
#include "meet.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int n = kLanes<float>;
constexpr float kNone = 1e9f;   // m
constexpr float kNear = 1e-6f;  // m, so near are boxes that meet

inline F least(const F& a, const F& b) { return a < b ? a : b; }
inline F most(const F& a, const F& b) { return a > b ? a : b; }

// The positions, and which blocks have vertices that moved or are marked.
void take(Meeting& m, const float* x, const float* mark, bool all) {
  for (int r = 0; r < m.rows; ++r)
    for (int k = 0; k < 3; ++k) {
      const float* const from = x + (std::size_t(k) * m.rows + r) * m.cols;
      float *const to = m.x.data() + k * m.plane + r * m.stride + 1, *const moved = m.moved.data() + r * m.stride + 1;
      const float* const marked = mark + r * m.cols;
      for (int c = 0; c < m.cols; ++c)
        moved[c] = all ? 1.0f : (k ? moved[c] : marked[c]) + (to[c] != from[c] ? 1.0f : 0.0f);
      std::memcpy(to, from, m.cols * sizeof(float));
      if (m.periodic) to[m.cols] = to[0], moved[m.cols] = moved[0];
    }
  std::fill(m.fresh.begin(), m.fresh.end(), all), std::fill(m.fresh_rows.begin(), m.fresh_rows.end(), all);
  for (int b = 0; !all && b < m.block_rows * m.block_cols; ++b) {
    const int r0 = b / m.block_cols * kSide, c0 = b % m.block_cols * kSide;
    float moved = 0;
    for (int r = r0; r <= std::min(r0 + kSide, m.rows - 1); ++r)
      for (int c = c0; c <= std::min(c0 + kSide, m.across); ++c) moved += m.moved[r * m.stride + 1 + c];
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
    float* const lower[3] = {m.lower.data() + i, m.lower.data() + m.plane + i, m.lower.data() + 2 * m.plane + i};
    put<float>(normal, 0, sum), put<float>(lower, 0, one);
    const F d = dot(one, other), yes = F{} + 1.0f;
    const auto level = (d > 0.0f) & (d * d > float(kPlain * kPlain) * dot(one, one) * dot(other, other));
    store<float>(m.plain.data() + i, level ? yes : -yes);
  }
  // Beside a sheet that ends its last cells are repeated, and there is nothing.
  const int last = m.across - 1;
  for (int k = 0; k < 3; ++k) {
    float *const low = m.low.data() + k * m.plane + row, *const high = m.high.data() + k * m.plane + row;
    float* const normal = m.normal.data() + k * m.plane + row;
    for (int c = m.across; c < kSide * m.block_cols; ++c) low[c] = kNone, high[c] = -kNone;
    normal[-1] = normal[m.periodic ? last : 0], normal[m.across] = normal[m.periodic ? 0 : last];
  }
}

// Whether cells are plain and level with those beside them.
void evenness(Meeting& m, int r) {
  const int up = r > 0 ? -m.stride : 0, below = r + 1 < m.down ? m.stride : 0;
  const float *const x = m.normal.data() + std::size_t(r) * m.stride + 1, *const y = x + m.plane,
                     *const z = y + m.plane;
  const float small = float(kSmall * kSmall) * m.twice * m.twice;
  for (int c = 0; c < m.across; c += n) {
    const auto get = [&](int by) -> V3<float> { return {load(x + c + by), load(y + c + by), load(z + c + by)}; };
    const V3<float> own = get(0);
    const F own2 = dot(own, own);
    auto even = (load(m.plain.data() + std::size_t(r) * m.stride + 1 + c) > 0.0f) & (own2 > small);
    for (const int by : {-1, 1, up, below}) {
      const V3<float> other = get(by);
      const F d = dot(own, other), other2 = dot(other, other);
      even &= (other2 > small) & (d > 0.0f) & (d * d > float(kLevel * kLevel) * own2 * other2);
    }
    const F yes = F{} + 1.0f;
    store<float>(m.even.data() + std::size_t(r) * m.stride + 1 + c, even ? yes : -yes);
  }
}

// The least or the most of the cells of a row of blocks; `get` gives those that begin at a number.
template <bool low, class Get>
void reduce(const Meeting& m, const Get& get, int rows, int across, float* to) {
  const auto better = [](const auto& a, const auto& b) { return low ? (a < b ? a : b) : (a > b ? a : b); };
  for (int c = 0; c < m.block_cols; c += n / kSide) {
    F v = get(kSide * c);
    for (int r = 1; r < rows; ++r) v = better(v, get(r * m.stride + kSide * c));
    alignas(64) float all[n];
    store<float>(all, v);
    for (int b = 0; b < n / kSide && c + b < m.block_cols; ++b) {
      const float* const four = all + kSide * b;
      float found = four[0];
      for (int i = 1; i < std::min(kSide, across - kSide * (c + b)); ++i) found = better(found, four[i]);
      to[c + b] = found;
    }
  }
}

// Of blocks and strips, from cells of the rows where something is fresh.
void boxes(Meeting& m) {
  for (int b = 0; b < m.block_rows; ++b) {
    if (!m.fresh_rows[b]) continue;
    const std::size_t first = std::size_t(b) * kSide * m.stride + 1;
    const int rows = std::min(kSide, m.down - kSide * b);
    for (int k = 0; k < 3; ++k) {
      float* const box = m.box.data() + k * m.blocks + b * m.block_cols;
      float* const cone = m.cone.data() + k * m.blocks + b * m.block_cols;
      const auto of = [&](const Plane<float>& plane) { return plane.data() + k * m.plane + first; };
      const float *const low = of(m.low), *const high = of(m.high), *const lower = of(m.lower),
                         *const sum = of(m.normal);
      const auto upper = [&](int i) { return load(sum + i) - load(lower + i); };
      reduce<true>(m, [&](int i) { return load(low + i); }, rows, m.across, box);
      reduce<false>(m, [&](int i) { return load(high + i); }, rows, m.across, box + 3 * m.blocks);
      reduce<true>(m, [&](int i) { return least(load(lower + i), upper(i)); }, rows, m.across, cone);
      reduce<false>(m, [&](int i) { return most(load(lower + i), upper(i)); }, rows, m.across, cone + 3 * m.blocks);
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

}  // namespace
}  // namespace LANES
}  // namespace minicloth
