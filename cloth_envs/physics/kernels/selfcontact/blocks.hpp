// Boxes of blocks, and which of them may come close. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>

#include "../base/simd.hpp"
#include "near.hpp"

namespace minicloth {
namespace LANES {
namespace {

constexpr double kFar = 1e9;    // m
constexpr double kFlat = 0.35;  // least part of the rest area that cells of flat blocks have along a common normal
constexpr double kSmall = 0.3;  // of the rest area, of cells whose normals tell little
constexpr double kLevel = 0.2;  // least cosine between neighbours' normals where cells up to kApart apart do not meet
constexpr int kApart = 2;

template <class T>
inline T lesser(T a, T b) {
  return a < b ? a : b;
}
template <class T>
inline T greater(T a, T b) {
  return a > b ? a : b;
}

// Normals of cells c0 to c1 - 1 of row r.
template <class T>
void row_of_normals(Sweep<T>& s, int r, int c0, int c1, int right, T unit) {
  const std::size_t first = std::size_t(r) * s.cols;
  const int down = s.cols, corner = right + down;
  const T *const X = s.x.data() + first, *const Y = X + s.plane, *const Z = Y + s.plane;
  T *const nx = s.normal.data() + first, *const ny = nx + s.plane, *const nz = ny + s.plane;
#pragma GCC ivdep
  for (int c = c0; c < c1; ++c) {
    const T ax = X[c + corner] - X[c], ay = Y[c + corner] - Y[c], az = Z[c + corner] - Z[c];
    const T bx = X[c + right] - X[c + down], by = Y[c + right] - Y[c + down], bz = Z[c + right] - Z[c + down];
    nx[c] = unit * (ay * bz - az * by), ny[c] = unit * (az * bx - ax * bz), nz[c] = unit * (ax * by - ay * bx);
  }
}

// What cells i + c are told of their neighbours j + c.
template <class T>
void join(Sweep<T>& s, std::size_t i, std::size_t j, int count) {
  const T *const x = s.normal.data(), *const y = x + s.plane, *const z = y + s.plane;
  T* const even = s.even.data();
  const T small = T(kSmall * kSmall), least = T(kLevel * kLevel);
#pragma GCC ivdep
  for (int c = 0; c < count; ++c) {
    const std::size_t a = i + c, b = j + c;
    const T d = x[a] * x[b] + (y[a] * y[b] + z[a] * z[b]);
    const T m = x[a] * x[a] + (y[a] * y[a] + z[a] * z[a]), n = x[b] * x[b] + (y[b] * y[b] + z[b] * z[b]);
    even[a] = lesser(even[a], (m > small && n > small && d > T(0) && d * d > least * m * n) ? T(1) : T(-1));
  }
}

// Normals of cells c0 to c1 - 1 of rows r0 to r1 - 1, and then whether they are even.
template <class T>
void normals(Sweep<T>& s, int r0, int r1, int c0, int c1, T unit) {
  const int last = s.cols - 1, inner = std::min(c1, last);
  for (int r = r0; r < r1; ++r) {
    row_of_normals(s, r, c0, inner, 1, unit);
    if (c1 > last) row_of_normals(s, r, last, s.cols, -last, unit);
  }
}
template <class T>
void evenness(Sweep<T>& s, int r0, int r1, int c0, int c1) {
  const int across = s.periodic ? s.cols : s.cols - 1;
  for (int r = r0; r < r1; ++r) {
    const std::size_t row = std::size_t(r) * s.cols, i = row + c0;
    std::fill_n(s.even.data() + i, c1 - c0, T(1));
    const int right = std::min(c1, across - 1), left = std::max(c0, 1);
    join(s, i, i + 1, right - c0), join(s, row + left, row + left - 1, c1 - left);
    if (s.periodic && c0 == 0) join(s, row, row + s.cols - 1, 1);
    if (s.periodic && c1 == s.cols) join(s, row + s.cols - 1, row, 1);
    if (r + 2 < s.rows) join(s, i, i + s.cols, c1 - c0);
    if (r > 0) join(s, i, i - s.cols, c1 - c0);
  }
}

// A block's points from a plane of vertices; some numbers behind `to` are written too.
template <class T>
inline void points(const Sweep<T>& s, int block, const T* plane, T* to) {
  const int first = s.at[block];
  if (s.row[first] + kSide < s.rows && s.col[first] + kSide < s.cols) {
    for (int r = 0; r <= kSide; ++r) std::memcpy(to + r * (kSide + 1), plane + first + r * s.cols, 8 * sizeof(T));
    for (int k = kPoints; k < kWide; ++k) to[k] = to[kPoints - 1];
  } else {
    for (int k = 0; k < kWide; ++k) to[k] = plane[s.point[kWide * block + k]];
  }
}

// Lane 0 gets the lowest of low and the highest of high.
template <class T, int half>
__attribute__((always_inline)) inline void halve(V<T>& low, V<T>& high) {
  constexpr int n = kLanes<T>;
  decltype(low < high) other;
#pragma GCC unroll 16
  for (int k = 0; k < n; ++k) other[k] = (k + half) % n;
  const V<T> l = pick(low, low, other), h = pick(high, high, other);
  low = l < low ? l : low, high = h > high ? h : high;
  if constexpr (half > 1) halve<T, half / 2>(low, high);
}

// Lowest and highest of the points from + t * way, or of them alone without ways.
template <class T>
inline void extent(const T* from, const T* way, T t, T* lo, T* hi) {
  constexpr int n = kLanes<T>;
  V<T> low = load(from) + t * load(way), high = low;
  for (int k = n; k < kWide; k += n) {
    const V<T> x = load(from + k) + t * load(way + k);
    low = x < low ? x : low, high = x > high ? x : high;
  }
  halve<T, n / 2>(low, high);
  *lo = low[0], *hi = high[0];
}

// The cells of a block that have a normal; of one that holds just the sheet's end, those before it.
struct Cells {
  int r0, r1, c0, c1;
};
template <class T>
inline Cells cells_of(const Sweep<T>& s, int block) {
  const int rows = s.rows - 1, cols = s.periodic ? s.cols : s.cols - 1, row = s.row[s.at[block]], col = s.col[s.at[block]];
  return {std::min(row, rows - 1), std::min(row + kSide, rows), std::min(col, cols - 1), std::min(col + kSide, cols)};
}

template <class T>
void boxes(Sweep<T>& s, T cell_area, bool all) {
  const std::size_t n = s.blocks;
  const int across = s.periodic ? s.cols : s.cols - 1;
  const T unit = T(0.5) / cell_area, part = (s.time - s.before) / (s.end - s.before);
  if (all) {
    normals(s, 0, s.rows - 1, 0, across, unit), evenness(s, 0, s.rows - 1, 0, across);
  } else {  // points of a box go straight: its sides are never outside of what lies between now and the end
    for (int k = 0; k < 6; ++k)
      for (std::size_t b = 0; b < n; ++b) s.box[k * n + b] += part * (s.box[(k + 6) * n + b] - s.box[k * n + b]);
  }
  s.before = s.time;
  for (const bool second : {false, true})
    for (int b = 0; b < s.blocks; ++b) {
      if (s.at[b] < 0 || !s.fresh[b]) continue;
      const auto [r0, r1, c0, c1] = cells_of(s, b);
      if (second) {
        if (!all) evenness(s, r0, r1, c0, c1);
        continue;
      }
      if (!all) normals(s, r0, r1, c0, c1, unit);
      for (int k = 0; k < 3; ++k) {
        T *const start = s.start.data() + (std::size_t(3) * b + k) * kWide, *const way = s.way.data() + (start - s.start.data());
        points(s, b, s.x.data() + k * s.plane, start), points(s, b, s.v.data() + k * s.plane, way);
        for (int i = 0; i < kWide; ++i) start[i] -= s.time * way[i];
        extent(start, way, s.time, &s.box[k * n + b], &s.box[(3 + k) * n + b]);
        extent(start, way, s.end, &s.box[(6 + k) * n + b], &s.box[(9 + k) * n + b]);
        T lo = T(kFar), hi = T(-kFar);
        for (int r = r0; r < r1; ++r)
          for (int c = c0; c < c1; ++c) {
            const T v = s.normal[k * s.plane + std::size_t(r) * s.cols + c];
            lo = lesser(lo, v), hi = greater(hi, v);
          }
        s.cone[k * n + b] = lo, s.cone[(3 + k) * n + b] = hi;
      }
    }
  const std::size_t stride = s.group.size() / kBox;
  for (int k = 0; k < kBox; ++k)
    for (int g = 0; g < s.groups; ++g) {
      const bool low = k / 3 % 2 == 0;
      T v = T(low ? kFar : -kFar);
      for (int i = g * kCells; i < (g + 1) * kCells; ++i)
        if (s.at[i] >= 0) v = low ? lesser(v, s.box[k * n + i]) : greater(v, s.box[k * n + i]);
      s.group[k * stride + g] = v;
    }
}

// A bit for every lane in which a < b.
template <class T>
inline unsigned less(const V<T>& a, const V<T>& b) {
#if defined(__AVX512F__)
  if constexpr (sizeof(T) == 4)
    return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_LT_OQ);
  else
    return _mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_LT_OQ);
#elif defined(__AVX2__)
  if constexpr (sizeof(T) == 4)
    return unsigned(_mm256_movemask_ps((__m256)(a < b)));
  else
    return unsigned(_mm256_movemask_pd((__m256d)(a < b)));
#elif defined(__SSE2__)
  if constexpr (sizeof(T) == 4)
    return unsigned(_mm_movemask_ps((__m128)(a < b)));
  else
    return unsigned(_mm_movemask_pd((__m128d)(a < b)));
#else
  unsigned found = 0;
  for (int k = 0; k < kLanes<T>; ++k) found |= unsigned(a[k] < b[k]) << k;
  return found;
#endif
}

// Which of a vector of boxes, planes `stride` apart, come nearer than reach to box a, whose numbers are `step` apart: as
// points go straight, a gap along an axis is never less than the lesser one of now and later.
template <class T>
inline unsigned meet(const T* a, std::size_t step, T reach, const T* b, std::size_t stride) {
  unsigned near = ~0u;
  for (int k = 0; k < 3; ++k) {
    const auto mine = [&](int i) { return V<T>{} + (a[(k + i) * step] + (i / 3 % 2 ? reach : -reach)); };
    const auto other = [&](int i) { return load(b + (k + i) * stride); };
    near &= (less<T>(other(0), mine(3)) | less<T>(other(6), mine(9))) &
            (less<T>(mine(0), other(3)) | less<T>(mine(6), other(9)));
  }
  return near;
}

// Whether blocks beside each other, or one alone, are so flat that their cells do not meet.
template <class T>
bool flat(const Sweep<T>& s, int a, int b) {
  T length = 0, spread = 0, axis[3];
  for (int k = 0; k < 3; ++k) {
    const std::size_t i = std::size_t(k) * s.blocks, j = std::size_t(3 + k) * s.blocks;
    const T lo = lesser(s.cone[i + a], s.cone[i + b]), hi = greater(s.cone[j + a], s.cone[j + b]);
    axis[k] = (lo + hi) / 2, length += axis[k] * axis[k], spread += (hi - lo) * (hi - lo) / 4;
  }
  length = std::sqrt(length);
  if (length - std::sqrt(spread) > T(kFlat)) return true;
  if (length < T(kFlat)) return false;
  const T *const x = s.normal.data(), *const y = x + s.plane, *const z = y + s.plane, least = T(kFlat) * length;
  for (const int block : {a, b}) {
    const auto [r0, r1, c0, c1] = cells_of(s, block);
    for (int r = r0; r < r1; ++r)
      for (int c = c0; c < c1; ++c) {
        const int i = r * s.cols + c;
        if (axis[0] * x[i] + axis[1] * y[i] + axis[2] * z[i] < least) return false;
      }
  }
  return true;
}

// Whether cells i and j lie at most `apart` cells from each other in the grid.
template <class T>
inline bool beside(const Sweep<T>& s, int i, int j, int apart) {
  const int dr = std::abs(s.row[i] - s.row[j]);
  int dc = std::abs(s.col[i] - s.col[j]);
  if (s.periodic) dc = std::min(dc, s.cols - dc);
  return dr <= apart && dc <= apart;
}

// The least gap of two boxes along an axis, now or later; `a` has its numbers `step` apart.
template <class T>
inline T box_gap(const T* a, const T* b, std::size_t step) {
  T most = T(-kFar);
  for (int k = 0; k < 3; ++k) {
    const auto at = [&](const T* box, int i) { return box[(k + i) * step]; };
    const T above = lesser(at(b, 0) - at(a, 3), at(b, 6) - at(a, 9));
    const T below = lesser(at(a, 0) - at(b, 3), at(a, 6) - at(b, 9));
    most = greater(most, greater(above, below));
  }
  return most;
}

template <class T>
void blocks(Sweep<T>& s, T near, T room, T most) {
  constexpr int n = kLanes<T>;
  const std::size_t stride = s.group.size() / kBox;
  const int next = kSide + (s.periodic ? kSide - 1 : 0);
  const T reach = near + most;
  s.most = most;
  thread_local std::vector<char> some_fresh;
  some_fresh.assign(s.groups, 0);
  for (int b = 0; b < s.blocks; ++b) some_fresh[b / kCells] |= s.fresh[b];
  s.close.clear();
  for (int g = 0; g < s.groups; ++g)
    for (int from = g / n * n; from < s.groups; from += n)
      for (unsigned groups = meet(s.group.data() + g, stride, reach, s.group.data() + from, stride); groups;
           groups &= groups - 1) {
        const int h = from + __builtin_ctz(groups);
        if (h < g || h >= s.groups || !(some_fresh[g] | some_fresh[h])) continue;
        unsigned some = 0;
        for (int k = 0; k < kCells; k += n)
          some |= meet(s.group.data() + h, stride, reach, s.box.data() + g * kCells + k, s.blocks) << k;
        for (; some; some &= some - 1) {
          const int a = g * kCells + __builtin_ctz(some);
          if (s.at[a] < 0 || !(s.fresh[a] | some_fresh[h])) continue;
          for (int k = h * kCells; k < (h + 1) * kCells; k += n)
            for (unsigned found = meet(s.box.data() + a, s.blocks, reach, s.box.data() + k, s.blocks); found;
                 found &= found - 1) {
              const int b = k + __builtin_ctz(found);
              if (b < a || s.at[b] < 0 || !(s.fresh[a] | s.fresh[b])) continue;
              if (beside(s, s.at[a], s.at[b], next) && flat(s, a, b)) continue;
              const T gap = box_gap(s.box.data() + a, s.box.data() + b, s.blocks) - near;
              if (gap < room) s.close.push_back(int(s.pairs.size()));
              s.pairs.push_back({a, b, greater(gap, room), true});
            }
        }
      }
}

template <class T>
T stray(Sweep<T>& s, T room, T* far) {
  const std::size_t n = s.blocks;
  alignas(64) T now[kWide];
  T mean[3] = {0, 0, 0};
  int count = 0;
  for (int b = 0; b < s.blocks; ++b) {
    s.fresh[b] = 0;
    if (s.at[b] < 0) continue;
    T spread = 0;
    ++count;
    for (int k = 0; k < 3; ++k) {
      const T *const start = s.start.data() + (std::size_t(3) * b + k) * kWide, *const way = s.way.data() + (start - s.start.data());
      points(s, b, s.x.data() + k * s.plane, now);
      for (int i = 0; i < kWide; ++i) now[i] -= start[i];
      T lo, hi;
      extent(now, way, -s.time, &lo, &hi);
      s.shift[k * n + b] = (lo + hi) / 2, mean[k] += (lo + hi) / 2, spread += (hi - lo) * (hi - lo) / 4;
    }
    s.shift[3 * n + b] = std::sqrt(spread);
  }
  T worst = 0, furthest = 0;
  const T* const shift = s.shift.data();
  thread_local std::vector<T> own;
  own.assign(n, T(0));
  const auto mark = [&](T strayed, T room, int a, int b) {
    const T part = strayed / room;
    worst = greater(worst, part);
    if (!(part < T(kTaken))) s.fresh[own[a] < own[b] ? b : a] = 1;
  };
  for (int b = 0; b < s.blocks; ++b) {
    if (s.at[b] < 0) continue;
    T square = 0;
    for (int k = 0; k < 3; ++k) square += (shift[k * n + b] - mean[k] / count) * (shift[k * n + b] - mean[k] / count);
    own[b] = std::sqrt(square) + shift[3 * n + b];
    mark(own[b], s.most / 2, b, b);
  }
  for (const BlockPair<T>& p : s.pairs) {
    if (!p.live) continue;
    T square = 0;
    for (int k = 0; k < 3; ++k) square += (shift[k * n + p.a] - shift[k * n + p.b]) * (shift[k * n + p.a] - shift[k * n + p.b]);
    const T strayed = std::sqrt(square) + (shift[3 * n + p.a] + shift[3 * n + p.b]);
    if (p.room <= room) furthest = greater(furthest, strayed);
    mark(strayed, p.room, p.a, p.b);
  }
  *far = furthest;
  return worst;
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
