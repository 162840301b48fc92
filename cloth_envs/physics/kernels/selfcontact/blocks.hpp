// Which blocks may come close, and which strayed from each other. Included where it is compiled for an instruction set.
#pragma once
#include <cmath>
#include <cstdlib>

#include "boxes.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Which of a vector of boxes, planes `stride` apart, come nearer than reach to box a, whose numbers are `step` apart:
// as points go straight, a gap along an axis is never less than the lesser one of now and later.
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
  const T least = T(kFlat) * length;
  for (const int block : {a, b}) {
    const auto [r0, r1, c0, c1] = s.with_triangles(block);
    for (int r = r0; r < r1; ++r)
      for (int c = c0; c < c1; ++c) {
        const int i = r * s.cols + c;
        for (const T* const n : {s.normal.data() + i, s.later.data() + i})
          if (axis[0] * n[0] + axis[1] * n[s.plane] + axis[2] * n[2 * s.plane] < least) return false;
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
              s.pairs.push_back({a, b, greater(gap, room), T(kStart), true});
            }
        }
      }
}

template <class T>
T stray(Sweep<T>& s) {
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
      const T *const start = &s.start[s.row_of(b, k)], *const way = &s.way[s.row_of(b, k)];
      points(s, b, s.x.data() + k * s.plane, now);
      for (int i = 0; i < kWide; ++i) now[i] -= start[i];
      T lo, hi;
      extent(now, way, -s.time, &lo, &hi);
      s.shift[k * n + b] = (lo + hi) / 2, mean[k] += (lo + hi) / 2, spread += (hi - lo) * (hi - lo) / 4;
    }
    s.shift[3 * n + b] = std::sqrt(spread);
  }
  T worst = 0;
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
    for (int k = 0; k < 3; ++k) {
      const T d = shift[k * n + b] - mean[k] / count;
      square += d * d;
    }
    own[b] = std::sqrt(square) + shift[3 * n + b];
    mark(own[b], s.most / 2, b, b);
  }
  for (BlockPair<T>& p : s.pairs) {
    if (!p.live) continue;
    T square = 0;
    for (int k = 0; k < 3; ++k) {
      const T d = shift[k * n + p.a] - shift[k * n + p.b];
      square += d * d;
    }
    const T strayed = std::sqrt(square) + (shift[3 * n + p.a] + shift[3 * n + p.b]);
    p.haste = lesser(greater(2 * strayed / s.time, T(kCalm)), T(kWild));
    mark(strayed, p.room, p.a, p.b);
  }
  return worst;
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
