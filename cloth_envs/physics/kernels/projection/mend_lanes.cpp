// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <cmath>
#include <vector>

#include "../base/geometry.hpp"
#include "../base/simd.hpp"
#include "mend.hpp"

namespace minicloth {
namespace LANES {
namespace {

using F = V<float>;
constexpr int kWide = kLanes<float>;

// Moves shortened cloth along its normal into waves of four edges, `wave` times as steep as would take all of it up;
// the border stays. Rows are computed from copies of the three around them as they were.
void buckle(const Mending& m, float* x) {
  const int n = m.rows * m.cols, inner = m.cols - 2, count = std::min(kWide, inner), stride = m.cols + kWide;
  thread_local Plane<float> memory;
  memory.resize(std::size_t(9 * stride + m.cols + 2 * kWide));
  float* const zigzag = memory.data() + 9 * stride;  // 0 1 0 -1 ...
  for (int c = 0; c < m.cols + kWide; ++c) zigzag[c] = float(c % 2 * (1 - c % 4 / 2 * 2));
  const auto row = [&](int r) { return memory.data() + r % 3 * 3 * stride; };
  const auto keep = [&](int r) {
    for (int k = 0; k < 3; ++k) std::copy_n(x + k * n + r * m.cols, m.cols, row(r) + k * stride);
  };
  const auto shortened = [&](const V3<float>& d, float whole) {  // by how much beyond buckling
    const F square = dot(d, d);
    return (1 - m.buckling) - square * rsqrt(square + tiny<float>) / whole;
  };
  const auto depth = [](const F& v) { return v * rsqrt_estimate(v + tiny<float>); };
  const float steep = std::sqrt(2.0f) * m.wave, along = 2 * m.col_length, down = 2 * m.row_length;
  keep(0), keep(1);
  for (int r = 1; r < m.rows - 1; ++r) {
    keep(r + 1);
    const float *const above = row(r - 1), *const here = row(r), *const below = row(r + 1);
    const F across = F{} + steep * m.row_length * zigzag[r % 4];
    for (int next = 1; next <= inner; next += kWide) {
      const int c = std::min(next, inner + 1 - count);
      const auto at = [&](const float* p) { return V3<float>{load(p), load(p + stride), load(p + 2 * stride)}; };
      const V3<float> a = at(here + c + 1) - at(here + c - 1), b = at(below + c) - at(above + c);
      const F less = larger(shortened(a, along), F{}), lower = larger(shortened(b, down), F{});
      if (!any<float>(less + lower > 0.0f)) continue;
      const V3<float> normal = cross(b, a);
      const F wave = (steep * m.col_length) * load(zigzag + c) * depth(less) + across * depth(lower);
      const V3<float> moved = at(here + c) + (wave * rsqrt_estimate(dot(normal, normal) + tiny<float>)) * normal;
      float* const to = x + r * m.cols + c;
      store_few(to, moved.x, count), store_few(to + n, moved.y, count), store_few(to + 2 * n, moved.z, count);
    }
  }
}

// An edge's length, and half of what it loses of what it is too long or too short.
struct Edge {
  F square, twice;  // of the length
  float longer, shorter, slack;

  Edge(float length, const Mending& m)
      : square(F{} + length * length), twice(square + square), longer(0.5f), shorter(m.shorter / 2), slack(m.slack) {}

  // Strain over stretch, 1 - L / |d|, is taken as (d^2 - L^2) / (d^2 + L^2), as Jakobsen 2001 does: without a root, and
  // finite where the ends meet.
  void pull(V3<float>& p, V3<float>& q) const {
    const V3<float> d = q - p;
    const F over = 1.0f - twice * reciprocal(dot(d, d) + square);
    const F share = longer * larger(over - slack, F{}) - shorter * larger(-over, F{});
    p = p + share * d, q = q - share * d;
  }
};

// Vectors of a field whose planes are n apart, whole or the first `count` lanes of them.
template <bool whole>
F take(const float* p, int count) {
  return whole ? load(p) : load_few(p, count);
}
template <bool whole>
void give(float* p, const F& v, int count) {
  whole ? store(p, v) : store_few(p, v, count);
}

// Edges from `count` vertices to those a row below.
template <bool whole>
void pull_down(const Edge& edge, float* above, int cols, int n, int count) {
  float* const below = above + cols;
  const auto get = [&](const float* p) {
    return V3<float>{take<whole>(p, count), take<whole>(p + n, count), take<whole>(p + 2 * n, count)};
  };
  const auto put = [&](float* p, const V3<float>& v) {
    give<whole>(p, v.x, count), give<whole>(p + n, v.y, count), give<whole>(p + 2 * n, v.z, count);
  };
  V3<float> p = get(above), q = get(below);
  edge.pull(p, q);
  put(above, p), put(below, q);
}

// Edges of the pairs of `count` vertices of a row.
template <bool whole>
void pull_along(const Edge& edge, float* x, int n, int count) {
  Places even, odd, low, high;  // of two vectors, and back
  for (int k = 0; k < kWide; ++k)
    even[k] = 2 * k, odd[k] = 2 * k + 1, low[k] = k / 2 + k % 2 * kWide, high[k] = low[k] + kWide / 2;
  const int some = std::min(count, kWide), more = count - some;
  const auto get = [&](const float* from, F& a, F& b) {
    const F u = take<whole>(from, some), v = take<whole>(from + kWide, more);
    a = pick(u, v, even), b = pick(u, v, odd);
  };
  const auto put = [&](float* to, const F& a, const F& b) {
    give<whole>(to, pick(a, b, low), some), give<whole>(to + kWide, pick(a, b, high), more);
  };
  V3<float> p, q;
  get(x, p.x, q.x), get(x + n, p.y, q.y), get(x + 2 * n, p.z, q.z);
  edge.pull(p, q);
  put(x, p.x, q.x), put(x + n, p.y, q.y), put(x + 2 * n, p.z, q.z);
}

// Edges along rows, of every second column and then of the others, and those between rows, in the same way. Ends of
// rows come after all else, of every second row: what was stored behind a mask can't be read soon, nor what lies beyond
// it.
void sweep(const Mending& m, const Edge& along, const Edge& down, float* x) {
  const int n = m.rows * m.cols;
  for (int first : {0, 1}) {
    const int count = (m.cols - first) / 2 * 2, body = count / (2 * kWide) * (2 * kWide);
    for (int r = 0; r < m.rows; ++r)
      for (int c = 0; c < body; c += 2 * kWide) pull_along<true>(along, x + r * m.cols + first + c, n, 2 * kWide);
    for (int turn = 0; turn < 2 && body < count; ++turn)
      for (int r = turn; r < m.rows; r += 2) pull_along<false>(along, x + r * m.cols + first + body, n, count - body);
  }
  for (int first : {0, 1}) {
    const int body = m.cols / kWide * kWide;
    for (int r = first; r + 1 < m.rows; r += 2)
      for (int c = 0; c < body; c += kWide) pull_down<true>(down, x + r * m.cols + c, m.cols, n, kWide);
    for (int r = first; r + 1 < m.rows && body < m.cols; r += 2)
      pull_down<false>(down, x + r * m.cols + body, m.cols, n, m.cols - body);
  }
}

void mend(const Mending& m, const int* held, std::size_t count, float* x) {
  const std::size_t n = std::size_t(m.rows) * m.cols;
  thread_local std::vector<float> kept;
  kept.resize(3 * count);
  for (std::size_t k = 0; k < 3; ++k)
    for (std::size_t i = 0; i < count; ++i) kept[k * count + i] = x[k * n + held[i]];
  const auto hold = [&] {
    for (std::size_t k = 0; k < 3; ++k)
      for (std::size_t i = 0; i < count; ++i) x[k * n + held[i]] = kept[k * count + i];
  };
  if (m.wave > 0) buckle(m, x), hold();
  const Edge along(m.col_length, m), down(m.row_length, m);
  for (int s = 0; s < m.sweeps; ++s) {
    sweep(m, along, down, x);
    hold();
  }
}

constexpr MendLanes instance = {mend};

}  // namespace
}  // namespace LANES

DEFINE_LANES(MendLanes, instance)

}  // namespace minicloth
