// Which cells of close blocks, and which of their parts, may come close. Included where it is compiled for an
// instruction set.
#pragma once
#include <cstring>

#include "blocks.hpp"
#include "distance.hpp"
#include "planes.hpp"

namespace minicloth {
namespace LANES {
namespace {

// The boxes of a block's cells side by side, empty where there are none, and their records.
template <class T>
const T* slots(Sweep<T>& s, int block) {
  typedef T Four __attribute__((vector_size(4 * sizeof(T))));
  T* const to = s.slots.data() + std::size_t(block) * kBox * kCells;
  if (s.filled[block]) return to;
  s.filled[block] = 1;
  constexpr int n = kLanes<T>, next = kSide + 1;
  const int first = s.at[block], rows = std::min(kSide, s.rows - s.row[first]);
  const int cols = std::min(kSide, s.cols - s.col[first]);
  unsigned level = 0;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < cols; ++c) level |= unsigned(s.even[first + r * s.cols + c] > T(0)) << (r * kSide + c);
  s.level[block] = std::uint16_t(level);
  const auto four = [](const T* p) {
    Four v;
    std::memcpy(&v, p, sizeof v);
    return v;
  };
  for (int k = 0; k < 6; ++k) {
    alignas(64) T x[kWide];
    const T *const start = &s.start[s.row_of(block, k % 3)], *const way = &s.way[s.row_of(block, k % 3)];
    for (int i = 0; i < kWide; i += n) store<T>(x + i, load(start + i) + (k < 3 ? s.time : s.end) * load(way + i));
    for (int r = 0; r < kSide; ++r) {
      T *const lo = to + (k + k / 3 * 3) * kCells + r * kSide, *const hi = lo + 3 * kCells;
      const Four p = four(x + r * next), q = four(x + r * next + 1), u = four(x + (r + 1) * next),
                 v = four(x + (r + 1) * next + 1);
      const Four pl = p < q ? p : q, ul = u < v ? u : v, ph = p > q ? p : q, uh = u > v ? u : v;
      const Four low = pl < ul ? pl : ul, high = ph > uh ? ph : uh;
      std::memcpy(lo, &low, sizeof low), std::memcpy(hi, &high, sizeof high);
      for (int c = r < rows ? cols : 0; c < kSide; ++c) lo[c] = T(kFar), hi[c] = T(-kFar);
    }
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < cols; ++c) {
        T* const to = s.records.data() + std::size_t(kRecord) * (first + r * s.cols + c) + k / 3 * 12 + k % 3;
        const T* const at = x + r * next + c;
        to[0] = at[0], to[3] = at[1], to[6] = at[next], to[9] = at[next + 1];
      }
  }
  return to;
}

template <class T>
void cells(Sweep<T>& s, T reach) {
  constexpr int n = kLanes<T>;
  static const Around around;
  std::fill(s.filled.begin(), s.filled.end(), 0);
  s.cells.clear();
  const std::size_t most = std::size_t(kCrowded) * s.rows * s.cols;
  for (const int number : s.close) {
    if (s.cells.size() > most) return s.cells.clear();  // it blew up
    const int a = s.pairs[number].a, b = s.pairs[number].b;
    const T *const first = slots(s, a), *const second = slots(s, b);
    unsigned some = 0, those = 0;
    for (int k = 0; k < kCells; k += n) some |= meet(s.box.data() + b, s.blocks, reach, first + k, kCells) << k;
    for (int k = 0; some && k < kCells; k += n)
      those |= meet(s.box.data() + a, s.blocks, reach, second + k, kCells) << k;
    some &= s.exists[a], those &= s.exists[b];
    if (!those) continue;
    const int dr = (s.row[s.at[b]] - s.row[s.at[a]]) / kSide, dc = (s.col[s.at[b]] - s.col[s.at[a]]) / kSide;
    const std::uint16_t* const beside_it =
        std::abs(dr) <= 1 && std::abs(dc) <= 1 ? around.cells[dr + 1][dc + 1] : nullptr;
    for (; some; some &= some - 1) {
      const int i = __builtin_ctz(some), at = s.at[a] + i / kSide * s.cols + i % kSide;
      unsigned wanted = those;
      if (a == b) wanted &= ~1u << i;
      if (beside_it && s.level[a] >> i & 1) wanted &= ~unsigned(beside_it[i] & s.level[b]);
      if (!wanted) continue;
      unsigned found = 0;
      for (int k = 0; k < kCells; k += n) found |= meet(first + i, kCells, reach, second + k, kCells) << k;
      for (found &= wanted; found; found &= found - 1) {
        const int j = __builtin_ctz(found), to = s.at[b] + j / kSide * s.cols + j % kSide;
        if (s.periodic && lesser(s.even[at], s.even[to]) > T(0) && beside(s, at, to, kApart)) continue;
        s.cells.push_back({at, to, number});
      }
    }
  }
}

// Blocks of `size` numbers of a square of vectors change places across its diagonal, then smaller ones.
template <class T, int size>
__attribute__((always_inline)) inline void turn(V<T>* row) {
  constexpr int n = kLanes<T>;
  using Index = decltype(V<T>{} < V<T>{});
  Index low, high;
#pragma GCC unroll 16
  for (int k = 0; k < n; ++k) low[k] = k & size ? n + k - size : k, high[k] = k & size ? n + k : k + size;
#pragma GCC unroll 16
  for (int l = 0; l < n; ++l)
    if (!(l & size)) {
      const V<T> a = row[l], b = row[l + size];
      row[l] = pick(a, b, low), row[l + size] = pick(a, b, high);
    }
  if constexpr (size > 1) turn<T, size / 2>(row);
}

// Vector k of `to` gets number k of every record.
template <class T>
__attribute__((always_inline)) inline void transpose(const T* const (&from)[kLanes<T>], V<T> (&to)[kRecord]) {
  constexpr int n = kLanes<T>;
#pragma GCC unroll 16
  for (int part = 0; part < kRecord; part += n) {
#pragma GCC unroll 16
    for (int l = 0; l < n; ++l) to[part + l] = load(from[l] + part);
    turn<T, n / 2>(to + part);
  }
}

// The corners of n pairs of cells, now and later: those of the first, then of the second cell.
template <class T>
struct Pairs {
  V3<T> now[2][4], then[2][4];
};
template <class T>
inline void get_pairs(const Sweep<T>& s, const int* which, int count, Pairs<T>& to) {
  constexpr int n = kLanes<T>;
  for (int half = 0; half < 2; ++half) {
    const T* from[n];
    for (int l = 0; l < n; ++l) {
      const CellPair& pair = s.cells[which[std::min(l, count - 1)]];
      from[l] = s.records.data() + std::size_t(kRecord) * (half ? pair.second : pair.first);
    }
    V<T> field[kRecord];
    transpose<T>(from, field);
    for (int q = 0; q < 4; ++q) {
      to.now[half][q] = {field[3 * q], field[3 * q + 1], field[3 * q + 2]};
      to.then[half][q] = {field[12 + 3 * q], field[13 + 3 * q], field[14 + 3 * q]};
    }
  }
}

template <class T, int count>
inline void range(const V3<T>& axis, const V3<T> (&x)[count], V<T>* lo, V<T>* hi) {
  *lo = *hi = dot(axis, x[0]);
  for (int q = 1; q < count; ++q) {
    const V<T> h = dot(axis, x[q]);
    *lo = h < *lo ? h : *lo, *hi = h > *hi ? h : *hi;
  }
}

// The gap between two cells along the normal of one of them: now, and the least while their corners go straight; below
// 0: none.
template <class T>
struct Gap {
  V<T> now, least;
};
template <class T>
inline Gap<T> gap(const Pairs<T>& p, int half) {
  const V3<T>(&x)[4] = p.now[half];
  const V3<T> up = cross(x[3] - x[0], x[1] - x[2]), n = rsqrt(dot(up, up) + tiny<T>) * up;
  V<T> lo[2][2], hi[2][2];  // [of the cell and the other][now, later]
  range(n, p.now[half], &lo[0][0], &hi[0][0]), range(n, p.then[half], &lo[0][1], &hi[0][1]);
  range(n, p.now[1 - half], &lo[1][0], &hi[1][0]), range(n, p.then[1 - half], &lo[1][1], &hi[1][1]);
  const auto least = [](const V<T>& a, const V<T>& b) { return a < b ? a : b; };
  const V<T> above = lo[1][0] - hi[0][0], below = lo[0][0] - hi[1][0];
  const V<T> up_to = least(above, lo[1][1] - hi[0][1]), down_to = least(below, lo[0][1] - hi[1][1]);
  return {above > below ? above : below, up_to > down_to ? up_to : down_to};
}

// Two parts: the vector between their nearest points now; and, times its length, how far apart they lie along it at the
// end. As points go straight, they are never nearer than the lesser of both.
template <class T>
struct Apart {
  V3<T> now;
  V<T> end;
};
template <class T>
inline Apart<T> vertex_and_triangle(const Pairs<T>& p, int k) {
  const int half = k / 2, b = k % 2 ? 3 : 2, c = k % 2 ? 1 : 3;
  const V3<T>&v = p.now[half][0], (&t)[4] = p.now[1 - half], (&u)[4] = p.then[1 - half];
  const V3<T> d = apart(of_triangle<T>(v, t[0], t[b], t[c]), v, t[0], t[b], t[c]);
  const V<T> e = dot(d, u[0]), f = dot(d, u[b]), g = dot(d, u[c]), ef = e > f ? e : f;
  return {d, dot(d, p.then[half][0]) - (ef > g ? ef : g)};
}
template <class T>
inline Apart<T> two_edges(const Pairs<T>& p, int k) {
  const int b = k / 3 + 1, c = k % 3 + 1;
  const V3<T>(&t)[4] = p.now[0], (&u)[4] = p.now[1], (&t1)[4] = p.then[0], (&u1)[4] = p.then[1];
  const V3<T> d = apart(of_edges<T>(t[0], t[b], u[0], u[c]), t[0], t[b], u[0], u[c]);
  const V<T> e = dot(d, t1[0]), f = dot(d, t1[b]), g = dot(d, u1[0]), h = dot(d, u1[c]);
  return {d, (e < f ? e : f) - (g > h ? g : h)};
}

constexpr double kTouch = 1e-5;  // m, apart, of cells that may still cross, as rounding has it

template <class T>
void parts(const Sweep<T>& s, const Looking<T>& how, T room, bool crossing, FirstLooks* first_looks) {
  constexpr int n = kLanes<T>;
  const int count = int(s.cells.size());
  const T time = s.end - s.time;
  const V<T> limit = V<T>{} + (how.reach + room), one = V<T>{} + T(1), most = V<T>{} + T(kMostSteps);
  thread_local std::vector<int> all, near;
  while (int(all.size()) < count) all.push_back(int(all.size()));
  near.clear();
  for (int i = 0; i < count; ++i) first_looks[i].which = 0, first_looks[i].meet = 0;
  Pairs<T> p;
  for (int first = 0; first < count; first += n) {
    get_pairs(s, all.data() + first, count - first, p);
    const Gap<T> a = gap(p, 0), b = gap(p, 1);
    const unsigned meet = less<T>(a.now > b.now ? a.now : b.now, V<T>{} + T(kTouch));
    for (unsigned found = less<T>(a.least > b.least ? a.least : b.least, limit); found; found &= found - 1) {
      const int l = __builtin_ctz(found);
      if (first + l >= count) break;
      near.push_back(first + l), first_looks[first + l].meet = crossing && (meet >> l & 1);
    }
  }
  for (int first = 0; first < int(near.size()); first += n) {
    const int left = int(near.size()) - first;
    get_pairs(s, near.data() + first, left, p);
    alignas(64) T haste[n];
    for (int l = 0; l < n; ++l) haste[l] = s.pairs[s.cells[near[first + std::min(l, left - 1)]].blocks].haste;
    const V<T> more = time * load(haste);
    const auto note = [&](const Apart<T>& d, int k) __attribute__((always_inline)) {
      const V<T> d2 = dot(d.now, d.now) + tiny<T>, inverse = rsqrt(d2), far = d2 * inverse, end = inverse * d.end;
      unsigned found = less<T>(far < end ? far : end, limit);
      if (left < n) found &= (1u << left) - 1;
      if (!found) return;
      const V<T> closes = far > end ? far - end : V<T>{};
      const V<T> w = (time / how.h) * ((far - how.danger) * reciprocal(closes + more));
      const V<T> steps = w < one ? one : (w > most ? most : w);
      for (; found; found &= found - 1) {
        const int l = __builtin_ctz(found);
        FirstLooks& to = first_looks[near[first + l]];
        to.wait[k] = std::uint8_t(steps[l]), to.which |= std::uint16_t(1 << k);
      }
    };
    if (crossing) {
      const Sides<T> one = sides<T>(p.now[0], p.now[1]), other = sides<T>(p.now[1], p.now[0]);
      unsigned may[4];
      for (int k = 0; k < 4; ++k) may[k] = bits<T>(~(one.apart[k / 2][k % 2] | other.apart[k % 2][k / 2]));
      for (int l = 0; l < std::min(left, n); ++l) {
        std::uint8_t& meet = first_looks[near[first + l]].meet;
        unsigned triangles = 0;
        for (int k = 0; k < 4; ++k) triangles |= (may[k] >> l & 1) << k;
        if (meet) meet = std::uint8_t(triangles);
      }
    }
    for (int k = 0; k < kVertexParts; ++k) note(vertex_and_triangle(p, k), k);
    for (int k = kVertexParts; k < kParts; ++k) note(two_edges(p, k - kVertexParts), k);
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
