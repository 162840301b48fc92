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
  const auto root = [](const F& v) { return v * rsqrt_estimate(v + tiny<float>); };
  const auto depth = [&](const V3<float>& d, float whole) {
    const F square = dot(d, d);
    return root(larger((1 - m.buckling) - square * rsqrt(square + tiny<float>) / whole, F{}));
  };
  const float steep = std::sqrt(2.0f) * m.wave, along = 2 * m.col_length, down = 2 * m.row_length;
  keep(0), keep(1);
  for (int r = 1; r < m.rows - 1; ++r) {
    keep(r + 1);
    const float *const above = row(r - 1), *const here = row(r), *const below = row(r + 1);
    const float across = steep * m.row_length * zigzag[r % 4];
    for (int next = 1; next <= inner; next += kWide) {
      const int c = std::min(next, inner + 1 - count);
      const auto at = [&](const float* p) { return V3<float>{load(p), load(p + stride), load(p + 2 * stride)}; };
      const V3<float> a = at(here + c + 1) - at(here + c - 1), b = at(below + c) - at(above + c), normal = cross(b, a);
      F wave = steep * m.col_length * load(zigzag + c) * depth(a, along);
      if (across != 0) wave += across * depth(b, down);
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

  Edge(float length, float share, const Mending& m)
      : square(F{} + length * length),
        twice(square + square),
        longer(share / 2),
        shorter(share / 2 * m.shorter),
        slack(m.slack) {}

  // Strain over stretch, 1 - L / |d|, is taken as (d^2 - L^2) / (d^2 + L^2), as Jakobsen 2001 does: without a root, and
  // finite where the ends meet.
  void pull(V3<float>& p, V3<float>& q, const F& exist) const {
    const V3<float> d = q - p;
    const F over = 1.0f - twice * reciprocal(dot(d, d) + square);
    const F share = exist * (longer * larger(over - slack, F{}) - shorter * larger(-over, F{}));
    p = p + share * d, q = q - share * d;
  }
};

// Diagonals and sides of every second cell of every second row, from cell (first, begin) on: no two have a vertex in
// common. Of sides that two cells have, one pulls.
void sweep(const Mending& m, int first, int begin, float* x) {
  const int n = m.rows * m.cols, cells = (m.cols - begin) / 2;
  const Edge diagonal(std::hypot(m.row_length, m.col_length), m.shear, m), along(m.col_length, 1, m),
      down(m.row_length, 1, m);
  Places lane, even, odd, low, high;  // of two vectors, and back
  for (int k = 0; k < kWide; ++k)
    lane[k] = k, even[k] = 2 * k, odd[k] = 2 * k + 1, low[k] = k / 2 + k % 2 * kWide, high[k] = low[k] + kWide / 2;
  const F one = F{} + 1.0f;
  const bool right = begin == 1 && m.cols % 2 == 1;
  for (int r = first; r + 1 < m.rows; r += 2) {
    const bool last = r + 2 == m.rows;
    float* const line = x + r * m.cols + begin;
    const auto cells_at = [&](int i, const auto& get, const auto& put) __attribute__((always_inline)) {
      float *const above = line + 2 * i, *const below = above + m.cols;
      V3<float> p, q, s, t;  // left and right, above and below
      get(above, p.x, q.x), get(above + n, p.y, q.y), get(above + 2 * n, p.z, q.z);
      get(below, s.x, t.x), get(below + n, s.y, t.y), get(below + 2 * n, s.z, t.z);
      diagonal.pull(p, t, one), diagonal.pull(q, s, one);
      if (first == 0) along.pull(p, q, one);
      if (first == 0 || last) along.pull(s, t, one);
      if (begin == 0) down.pull(p, s, one), down.pull(q, t, one);
      if (right && i + kWide >= cells) down.pull(q, t, lane == cells - i - 1 ? one : F{});
      put(above, p.x, q.x), put(above + n, p.y, q.y), put(above + 2 * n, p.z, q.z);
      put(below, s.x, t.x), put(below + n, s.y, t.y), put(below + 2 * n, s.z, t.z);
    };
    int i = 0;
    for (; i + kWide <= cells; i += kWide)
      cells_at(
          i,
          [&](const float* from, F& a, F& b) __attribute__((always_inline)) {
            const F u = load(from), v = load(from + kWide);
            a = pick(u, v, even), b = pick(u, v, odd);
          },
          [&](float* to, const F& a, const F& b)
              __attribute__((always_inline)) { store(to, pick(a, b, low)), store(to + kWide, pick(a, b, high)); });
    const int some = std::min(2 * (cells - i), kWide), more = 2 * (cells - i) - some;
    if (some > 0)
      cells_at(
          i,
          [&](const float* from, F& a, F& b) __attribute__((always_inline)) {
            const F u = load_few(from, some), v = load_few(from + kWide, more);
            a = pick(u, v, even), b = pick(u, v, odd);
          },
          [&](float* to, const F& a, const F& b) __attribute__((always_inline)) {
            store_few(to, pick(a, b, low), some), store_few(to + kWide, pick(a, b, high), more);
          });
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
  for (int s = 0; s < m.sweeps; ++s) {
    for (int first : {0, 1})
      for (int begin : {0, 1}) sweep(m, first, begin, x);
    hold();
  }
}

constexpr MendLanes instance = {mend};

}  // namespace
}  // namespace LANES

DEFINE_LANES(MendLanes, instance)

}  // namespace minicloth
