// Boxes of blocks, and which of them may come close. Included where it is compiled for an instruction set.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdlib>

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

template <class T>
void row_of_normals(Sweep<T>& s, int r, int c0, int c1, int right, T unit) {
  const std::size_t first = std::size_t(r) * s.cols;
  const int down = s.cols, corner = right + down;
  const T *const X = s.now.data() + first, *const Y = X + s.plane, *const Z = Y + s.plane;
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
void join_one(Sweep<T>& s, std::size_t i, std::size_t j, int count) {
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
template <class T>
void join(Sweep<T>& s, std::size_t i, std::size_t j, int count) {
  join_one(s, i, j, count), join_one(s, j, i, count);
}

template <class T>
void normals(Sweep<T>& s, T cell_area) {
  const int cols = s.cols, last = cols - 1, across = s.periodic ? cols : last;
  const T unit = T(0.5) / cell_area;
  for (int r = 0; r + 1 < s.rows; ++r) {
    row_of_normals(s, r, 0, last, 1, unit);
    if (s.periodic) row_of_normals(s, r, last, cols, -last, unit);
  }
  std::fill(s.even.begin(), s.even.end(), T(1));
  for (int r = 0; r + 1 < s.rows; ++r) {
    const std::size_t i = std::size_t(r) * cols;
    join(s, i, i + 1, across - 1);
    if (s.periodic) join(s, i, i + last, 1);
    if (r + 2 < s.rows) join(s, i, i + cols, across);
  }
}

// Of every block lowest and highest of a plane's `rows` x `cols` first numbers; blocks are `more` rows and columns
// larger than their cells.
template <class T>
void to_blocks(const Sweep<T>& s, const T* plane, int rows, int cols, int more, T* lo, T* hi) {
  thread_local std::vector<T> lines;
  lines.resize(2 * (s.cols + 1));
  T *const low = lines.data(), *const high = low + s.cols + 1;
  std::fill_n(lo, s.blocks, T(kFar)), std::fill_n(hi, s.blocks, T(-kFar));
  const int most = s.periodic && more ? cols + 1 : cols;
  for (int b = 0; b < s.block_rows; ++b) {
    const int r0 = b * kSide, r1 = std::min(r0 + kSide + more, rows);
    if (r1 <= r0) continue;
    std::copy_n(plane + std::size_t(r0) * s.cols, s.cols, low), std::copy_n(low, s.cols, high);
    for (int r = r0 + 1; r < r1; ++r) {
      const T* const row = plane + std::size_t(r) * s.cols;
#pragma GCC ivdep
      for (int c = 0; c < s.cols; ++c) low[c] = lesser(low[c], row[c]), high[c] = greater(high[c], row[c]);
    }
    low[s.cols] = low[0], high[s.cols] = high[0];
    const int first = b / kSide * s.group_cols * kCells + b % kSide * kSide;
    for (int a = 0; a < s.block_cols; ++a) {
      const int c0 = a * kSide, c1 = std::min(c0 + kSide + more, most);
      T l = T(kFar), h = T(-kFar);
      for (int c = c0; c < c1; ++c) l = lesser(l, low[c]), h = greater(h, high[c]);
      lo[first + a / kSide * kCells + a % kSide] = l, hi[first + a / kSide * kCells + a % kSide] = h;
    }
  }
}

template <class T>
void group_box(Sweep<T>& s, int g) {
  const std::size_t stride = s.group.size() / kBox;
  for (int k = 0; k < kBox; ++k) {
    const T* const from = s.box.data() + std::size_t(k) * s.blocks + g * kCells;
    T v = from[0];
    for (int i = 1; i < kCells; ++i) v = k / 3 % 2 ? greater(v, from[i]) : lesser(v, from[i]);
    s.group[k * stride + g] = v;
  }
}

template <class T>
void fresh_boxes(Sweep<T>& s, T cell_area) {
  const T unit = T(0.5) / cell_area;
  const int across = s.periodic ? s.cols : s.cols - 1;
  for (int b = 0; b < s.blocks; ++b) {
    if (!s.fresh[b] || s.at[b] < 0) continue;
    for (int k = 0; k < 6; ++k) {
      const T* const x = (k < 3 ? s.now : s.then).data() + k % 3 * s.plane;
      T lo = T(kFar), hi = T(-kFar);
      s.each_vertex(b, [&](int i) { lo = lesser(lo, x[i]), hi = greater(hi, x[i]); });
      T* const to = s.box.data() + std::size_t(k + k / 3 * 3) * s.blocks + b;
      to[0] = lo, to[std::size_t(3) * s.blocks] = hi;
    }
    const int first = s.at[b], r1 = std::min(kSide, s.rows - 1 - s.row[first]), c1 = std::min(kSide, across - s.col[first]);
    for (int r = 0; r < r1; ++r) {
      const int row = s.row[first] + r, c0 = s.col[first], inner = std::min(c0 + c1, s.cols - 1);
      row_of_normals(s, row, c0, inner, 1, unit);
      if (c0 + c1 > inner) row_of_normals(s, row, inner, inner + 1, 1 - s.cols, unit);
    }
    for (int k = 0; k < 3; ++k) {
      T lo = T(kFar), hi = T(-kFar);
      for (int r = 0; r < r1; ++r)
        for (int c = 0; c < c1; ++c) {
          const T v = s.normal[k * s.plane + first + r * s.cols + c];
          lo = lesser(lo, v), hi = greater(hi, v);
        }
      s.cone[std::size_t(k) * s.blocks + b] = lo, s.cone[std::size_t(3 + k) * s.blocks + b] = hi;
    }
  }
  for (int g = 0; g < s.groups; ++g)
    if (std::any_of(s.fresh.begin() + g * kCells, s.fresh.begin() + (g + 1) * kCells, [](char f) { return f != 0; }))
      group_box(s, g);
  for (int b = 0; b < s.blocks; ++b) {
    if (!s.fresh[b] || s.at[b] < 0) continue;
    const int first = s.at[b], r1 = std::min(kSide, s.rows - 1 - s.row[first]), c1 = std::min(kSide, across - s.col[first]);
    for (int r = 0; r < r1; ++r) {
      const std::size_t i = first + r * s.cols;
      for (int c = 0; c < c1; ++c) s.even[i + c] = T(1);
      const bool more = s.col[first] + c1 < across;
      const int row = s.row[first] + r;
      join_one(s, i, i + 1, c1 - 1 + more);
      if (s.col[first] > 0) join_one(s, i, i - 1, 1);
      if (row + 2 < s.rows) join_one(s, i, i + s.cols, c1);
      if (row > 0) join_one(s, i, i - s.cols, c1);
      if (s.periodic && s.col[first] == 0) join_one(s, i, i + s.cols - 1, 1);
      if (s.periodic && !more) join_one(s, i + c1 - 1, i - s.col[first], 1);
    }
  }
}

template <class T>
int stray(Sweep<T>& s, const Plane<T>& x, T part) {
  thread_local Plane<T> far, lo, hi;
  const int n = s.rows * s.cols;
  far.resize(s.plane), lo.resize(s.blocks), hi.resize(s.blocks);
  const T *const a = s.now.data(), *const b = s.then.data(), *const c = x.data(), *const slack = s.slack.data();
  T* const to = far.data();
  const std::size_t p = s.plane;
#pragma GCC ivdep
  for (int i = 0; i < n; ++i) {
    const T u = c[i] - (a[i] + part * (b[i] - a[i])), v = c[p + i] - (a[p + i] + part * (b[p + i] - a[p + i]));
    const T w = c[2 * p + i] - (a[2 * p + i] + part * (b[2 * p + i] - a[2 * p + i]));
    to[i] = u * u + (v * v + w * w) - slack[i];
  }
  to_blocks(s, far.data(), s.rows, s.cols, 1, lo.data(), hi.data());
  int many = 0;
  for (int k = 0; k < s.blocks; ++k) s.fresh[k] = s.at[k] >= 0 && hi[k] > 0, many += s.fresh[k];
  return many;
}

template <class T>
void boxes(Sweep<T>& s, T cell_area) {
  normals(s, cell_area);
  const int across = s.periodic ? s.cols : s.cols - 1;
  for (int k = 0; k < 3; ++k) {
    T *const box = s.box.data() + std::size_t(k) * s.blocks, *const cone = s.cone.data() + std::size_t(k) * s.blocks;
    const std::size_t from = k * s.plane, three = std::size_t(3) * s.blocks;
    to_blocks(s, s.now.data() + from, s.rows, s.cols, 1, box, box + three);
    to_blocks(s, s.then.data() + from, s.rows, s.cols, 1, box + 2 * three, box + 3 * three);
    to_blocks(s, s.normal.data() + from, s.rows - 1, across, 0, cone, cone + three);
  }
  for (int g = 0; g < s.groups; ++g) group_box(s, g);
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
    if (lo > hi) return true;
    axis[k] = (lo + hi) / 2, length += axis[k] * axis[k], spread += (hi - lo) * (hi - lo) / 4;
  }
  length = std::sqrt(length);
  if (length - std::sqrt(spread) > T(kFlat)) return true;
  if (length < T(kFlat)) return false;
  const T *const x = s.normal.data(), *const y = x + s.plane, *const z = y + s.plane, least = T(kFlat) * length;
  const int across = s.periodic ? s.cols : s.cols - 1;
  for (const int block : {a, b}) {
    const int first = s.at[block], rows = std::min(kSide, s.rows - 1 - s.row[first]);
    const int cols = std::min(kSide, across - s.col[first]);
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < cols; ++c) {
        const int i = first + r * s.cols + c;
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
void blocks(Sweep<T>& s, T near, T skin, T most) {
  constexpr int n = kLanes<T>;
  const std::size_t stride = s.group.size() / kBox;
  const int next = kSide + (s.periodic ? kSide - 1 : 0);
  const T reach = near + 2 * most, close = near + 2 * skin;
  s.close_blocks.clear();
  for (int b = 0; b < s.blocks; ++b)
    if (s.fresh[b]) s.room[b] = most;
  thread_local std::vector<char> some_fresh;
  some_fresh.assign(s.groups, 0);
  for (int b = 0; b < s.blocks; ++b) some_fresh[b / kCells] |= s.fresh[b];
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
              if (b < a || s.at[b] < 0 || !(s.fresh[a] | s.fresh[b]) || (beside(s, s.at[a], s.at[b], next) && flat(s, a, b))) continue;
              const T gap = box_gap(s.box.data() + a, s.box.data() + b, s.blocks);
              const T room = gap < close ? skin : (gap - near) / 2;
              s.room[a] = lesser(s.room[a], room), s.room[b] = lesser(s.room[b], room);
              if (gap < close) s.close_blocks.push_back({a, b});
            }
        }
      }
  std::fill_n(s.slack.data(), s.rows * s.cols, most * most);
  for (int b = 0; b < s.blocks; ++b)
    if (s.at[b] >= 0 && s.room[b] < most)
      s.each_vertex(b, [&](int i) { s.slack[i] = lesser(s.slack[i], s.room[b] * s.room[b]); });
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
