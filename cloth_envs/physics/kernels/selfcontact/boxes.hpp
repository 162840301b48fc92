// Boxes and normals of blocks. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>

#include "../base/simd.hpp"
#include "even.hpp"

namespace minicloth {
namespace LANES {
namespace {

constexpr double kFar = 1e9;  // m

template <class T>
inline T lesser(T a, T b) {
  return a < b ? a : b;
}
template <class T>
inline T greater(T a, T b) {
  return a > b ? a : b;
}

// Whether the two triangles of a cell are nearly level with each other: `n` is their normals' sum, `low` that of one.
template <class T>
inline bool level(const T* n, const T* low) {
  const T high[3] = {n[0] - low[0], n[1] - low[1], n[2] - low[2]};
  const auto times = [](const T* a, const T* b) { return a[0] * b[0] + (a[1] * b[1] + a[2] * b[2]); };
  const T d = times(low, high);
  return bool(int(d > T(0)) & int(d * d > T(kPlain * kPlain) * times(low, low) * times(high, high)));
}

// Normals of cells c0 to c1 - 1 of row r, now and at the end of their ways, `time` from now.
template <class T>
void row_of_normals(Sweep<T>& s, int r, int c0, int c1, int right, T unit, T time) {
  const std::size_t first = std::size_t(r) * s.cols, plane = s.plane;
  const int down = s.cols, corner = right + down;
  const T *const x = s.x.data() + first, *const v = s.v.data() + first;
  T *const now = s.normal.data() + first, *const later = s.later.data() + first, *const plain = s.plain.data() + first;
#pragma GCC ivdep
  for (int c = c0; c < c1; ++c) {
    T a[2][3], b[2][3], e[2][3], n[2][3], low[2][3];
    for (int k = 0; k < 3; ++k) {
      const T *const at = x + k * plane + c, *const goes = v + k * plane + c;
      a[0][k] = at[corner] - at[0], b[0][k] = at[right] - at[down], e[0][k] = at[down] - at[0];
      a[1][k] = a[0][k] + time * (goes[corner] - goes[0]), b[1][k] = b[0][k] + time * (goes[right] - goes[down]);
      e[1][k] = e[0][k] + time * (goes[down] - goes[0]);
    }
    for (int t = 0; t < 2; ++t)
      for (int k = 0; k < 3; ++k) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        n[t][k] = a[t][i] * b[t][j] - a[t][j] * b[t][i], low[t][k] = e[t][i] * a[t][j] - e[t][j] * a[t][i];
      }
    for (int k = 0; k < 3; ++k) now[k * plane + c] = unit * n[0][k], later[k * plane + c] = unit * n[1][k];
    plain[c] = int(level(n[0], low[0])) & int(level(n[1], low[1])) ? T(1) : T(-1);
  }
}

// What cells i + c are told of their neighbours j + c.
template <class T>
void join(Sweep<T>& s, std::size_t i, std::size_t j, int count) {
  T* const even = s.even.data();
  const T small = T(kSmall * kSmall), least = T(kLevel * kLevel);
  for (const T* const x : {s.normal.data(), s.later.data()}) {
    const T *const y = x + s.plane, *const z = y + s.plane;
#pragma GCC ivdep
    for (int c = 0; c < count; ++c) {
      const std::size_t a = i + c, b = j + c;
      const T d = x[a] * x[b] + (y[a] * y[b] + z[a] * z[b]);
      const T m = x[a] * x[a] + (y[a] * y[a] + z[a] * z[a]), n = x[b] * x[b] + (y[b] * y[b] + z[b] * z[b]);
      even[a] = lesser(even[a], (m > small && n > small && d > T(0) && d * d > least * m * n) ? T(1) : T(-1));
    }
  }
}

// Normals of cells c0 to c1 - 1 of rows r0 to r1 - 1, and then whether they are even.
template <class T>
void normals(Sweep<T>& s, int r0, int r1, int c0, int c1, T unit, T time) {
  const int last = s.cols - 1, inner = std::min(c1, last);
  for (int r = r0; r < r1; ++r) {
    row_of_normals(s, r, c0, inner, 1, unit, time);
    if (c1 > last) row_of_normals(s, r, last, s.cols, -last, unit, time);
  }
}
template <class T>
void evenness(Sweep<T>& s, int r0, int r1, int c0, int c1) {
  const int across = s.periodic ? s.cols : s.cols - 1;
  for (int r = r0; r < r1; ++r) {
    const std::size_t row = std::size_t(r) * s.cols, i = row + c0;
    std::copy_n(s.plain.data() + i, c1 - c0, s.even.data() + i);
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

template <class T>
void boxes(Sweep<T>& s, T cell_area, bool all) {
  const std::size_t n = s.blocks;
  const int across = s.periodic ? s.cols : s.cols - 1;
  const T left = s.end - s.time, unit = T(0.5) / cell_area, part = (s.time - s.before) / (s.end - s.before);
  if (all) {
    normals(s, 0, s.rows - 1, 0, across, unit, left), evenness(s, 0, s.rows - 1, 0, across);
  } else {  // points of a box go straight: its sides are never outside of what lies between now and the end
    for (int k = 0; k < 6; ++k)
      for (std::size_t b = 0; b < n; ++b) s.box[k * n + b] += part * (s.box[(k + 6) * n + b] - s.box[k * n + b]);
  }
  s.before = s.time;
  for (const bool second : {false, true})
    for (int b = 0; b < s.blocks; ++b) {
      if (s.at[b] < 0 || !s.fresh[b]) continue;
      const auto [r0, r1, c0, c1] = s.with_triangles(b);
      if (second) {
        if (!all) evenness(s, r0, r1, c0, c1);
        continue;
      }
      if (!all) normals(s, r0, r1, c0, c1, unit, left);
      for (int k = 0; k < 3; ++k) {
        T *const start = &s.start[s.row_of(b, k)], *const way = &s.way[s.row_of(b, k)];
        points(s, b, s.x.data() + k * s.plane, start), points(s, b, s.v.data() + k * s.plane, way);
        for (int i = 0; i < kWide; ++i) start[i] -= s.time * way[i];
        extent(start, way, s.time, &s.box[k * n + b], &s.box[(3 + k) * n + b]);
        extent(start, way, s.end, &s.box[(6 + k) * n + b], &s.box[(9 + k) * n + b]);
        T lo = T(kFar), hi = T(-kFar);
        for (int r = r0; r < r1; ++r)
          for (int c = c0; c < c1; ++c) {
            const std::size_t i = k * s.plane + std::size_t(r) * s.cols + c;
            const T now = s.normal[i], later = s.later[i];
            lo = lesser(lo, lesser(now, later)), hi = greater(hi, greater(now, later));
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

}  // namespace
}  // namespace LANES
}  // namespace minicloth
