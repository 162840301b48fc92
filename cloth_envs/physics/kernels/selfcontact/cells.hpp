// Which cells of close blocks, and which of their parts, may come close. Included where it is compiled for an
// instruction set.
#pragma once
#include <cstring>

#include <time.h>
extern double dbg_t[8];
#include "blocks.hpp"
#include "distance.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
void record(Sweep<T>& s, int cell) {
  T* const to = s.records.data() + std::size_t(kRecord) * cell;
  const int at[4] = {s.corner[0][cell], s.corner[1][cell], s.corner[2][cell], s.corner[3][cell]};
  T ways[6];
  for (int k = 0; k < 3; ++k) {
    const T *const x = s.x.data() + k * s.plane, *const w = s.way.data() + k * s.plane;
    for (int q = 0; q < 4; ++q) to[3 * q + k] = x[at[q]];
    ways[k] = lesser(lesser(w[at[0]], w[at[1]]), lesser(w[at[2]], w[at[3]]));
    ways[3 + k] = greater(greater(w[at[0]], w[at[1]]), greater(w[at[2]], w[at[3]]));
  }
  centre(ways, 1);
  std::copy_n(ways, 4, to + 12);
}

// The boxes of a block's cells side by side; where there are none they are empty.
template <class T>
const T* slots(Sweep<T>& s, int block) {
  typedef T Four __attribute__((vector_size(4 * sizeof(T))));
  T* const to = s.slots.data() + std::size_t(block) * 10 * kCells;
  if (s.filled[block]) return to;
  s.filled[block] = 1;
  const int first = s.at[block], rows = std::min(kSide, s.rows - s.row[first]);
  const int cols = std::min(kSide, s.cols - s.col[first]);
  unsigned level = 0;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < cols; ++c) {
      level |= unsigned(s.even[first + r * s.cols + c] > T(0)) << (r * kSide + c);
      const int cell = first + r * s.cols + c;
      record(s, cell);
      for (int k = 0; k < 4; ++k) to[(6 + k) * kCells + r * kSide + c] = s.records[std::size_t(kRecord) * cell + 12 + k];
    }
  s.level[block] = std::uint16_t(level);
  const auto four = [](const T* p) {
    Four v;
    std::memcpy(&v, p, sizeof v);
    return v;
  };
  const int across = s.corner[1][first + cols - 1] - (first + cols - 1);
  for (int r = 0; r < kSide; ++r) {
    const int cell = first + std::min(r, rows - 1) * s.cols, down = s.corner[2][cell] - cell;
    for (int k = 0; k < 3; ++k) {
      const T* const x = s.x.data() + k * s.plane + cell;
      T *const lo = to + k * kCells + r * kSide, *const hi = lo + 3 * kCells;
      const Four p = four(x), q = four(x + 1), u = four(x + down), v = four(x + down + 1);
      const Four pl = p < q ? p : q, ul = u < v ? u : v, ph = p > q ? p : q, uh = u > v ? u : v;
      const Four low = pl < ul ? pl : ul, high = ph > uh ? ph : uh;
      std::memcpy(lo, &low, sizeof low), std::memcpy(hi, &high, sizeof high);
      if (across != 1) {  // the last column
        const int c = cols - 1;
        const T a = x[c], b = x[c + across], d = x[c + down], e = x[c + across + down];
        lo[c] = lesser(lesser(a, b), lesser(d, e)), hi[c] = greater(greater(a, b), greater(d, e));
      }
      for (int c = r < rows ? cols : 0; c < kSide; ++c) lo[c] = T(kFar), hi[c] = T(-kFar);
    }
  }
  return to;
}

// Of cell i of a block, the cells up to kApart apart in the block dr - 1, dc - 1 blocks further.
struct Around {
  std::uint16_t cells[3][3][kCells] = {};
  Around() {
    for (int block = 0; block < 9; ++block)
      for (int i = 0; i < kCells; ++i)
        for (int j = 0; j < kCells; ++j) {
          const int r = (block / 3 - 1) * kSide + j / kSide - i / kSide, c = (block % 3 - 1) * kSide + j % kSide - i % kSide;
          const bool near = std::abs(r) <= kApart && std::abs(c) <= kApart;
          cells[block / 3][block % 3][i] |= std::uint16_t(near << j);
        }
  }
};

template <class T>
void cells(Sweep<T>& s, T reach) {
  constexpr int n = kLanes<T>;
  static const Around around;
  std::fill(s.filled.begin(), s.filled.end(), 0);
  s.close_cells.clear();
  for (std::size_t p = 0; p < s.close_blocks.size(); ++p) {
    const auto [a, b] = s.close_blocks[p];
    const V<T> span = V<T>{} + s.spans[p];
    const T *const first = slots(s, a), *const second = slots(s, b);
    unsigned some = 0, those = 0;
    for (int k = 0; k < kCells; k += n) some |= meet<T>(s.box.data() + b, s.blocks, span, first + k, kCells) << k;
    for (int k = 0; some && k < kCells; k += n)
      those |= meet<T>(s.box.data() + a, s.blocks, span, second + k, kCells) << k;
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
      for (int k = 0; k < kCells; k += n) {
        const V<T> near = reach + approach(first + 6 * kCells + i, kCells, second + 6 * kCells + k, kCells);
        found |= meet<T>(first + i, kCells, near, second + k, kCells) << k;
      }
      for (found &= wanted; found; found &= found - 1) {
        const int j = __builtin_ctz(found), to = s.at[b] + j / kSide * s.cols + j % kSide;
        if (s.periodic && lesser(s.even[at], s.even[to]) > T(0) && beside(s, at, to, kApart)) continue;
        s.close_cells.push_back({at, to});
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

// The corners of n pairs of cells, those of the second half after those of the first, and how far they go towards each
// other.
template <class T>
struct Pairs {
  V3<T> x[2][4];
  V<T> going;
};
template <class T>
inline void get_pairs(const Sweep<T>& s, const int* which, int count, Pairs<T>& to) {
  constexpr int n = kLanes<T>;
  V<T> field[2][kRecord];
  for (int half = 0; half < 2; ++half) {
    const T* from[n];
    for (int l = 0; l < n; ++l) {
      const auto& pair = s.close_cells[which[std::min(l, count - 1)]];
      from[l] = s.records.data() + std::size_t(kRecord) * (half ? pair.second : pair.first);
    }
    transpose<T>(from, field[half]);
    for (int q = 0; q < 4; ++q) to.x[half][q] = {field[half][3 * q], field[half][3 * q + 1], field[half][3 * q + 2]};
  }
  const V3<T> way = {field[0][12] - field[1][12], field[0][13] - field[1][13], field[0][14] - field[1][14]};
  const V<T> square = dot(way, way) + tiny<T>;
  to.going = square * rsqrt(square) + (field[0][15] + field[1][15]);
}

// How far a cell's plane, give or take how far the cell is from it, lies from the corners of another on one side of it;
// less than 0 where they lie on both.
template <class T>
inline V<T> clear(const V3<T> (&cell)[4], const V3<T> (&other)[4]) {
  const V3<T> up = cross(cell[3] - cell[0], cell[1] - cell[2]);
  const V<T> n2 = dot(up, up) + tiny<T>, inverse = rsqrt(n2);
  const V3<T> n = inverse * up, sum = (cell[0] + cell[3]) + (cell[1] + cell[2]);
  const V<T> level = T(0.25) * dot(n, sum), bend = T(0.25) * dot(n, (cell[0] + cell[3]) - (cell[1] + cell[2]));
  V<T> lo = dot(n, other[0]), hi = lo;
  for (int q = 1; q < 4; ++q) {
    const V<T> h = dot(n, other[q]);
    lo = h < lo ? h : lo, hi = h > hi ? h : hi;
  }
  const V<T> above = lo - level, below = level - hi, most = above > below ? above : below;
  return most - (bend < T(0) ? -bend : bend);
}

template <class T>
void parts(const Sweep<T>& s, const Looking<T>& vertices, const Looking<T>& edges, T skin, T time,
           std::uint8_t (*wait)[kParts + 2]) {
  constexpr int n = kLanes<T>;
  thread_local std::vector<int> all, with_vertices, with_edges;
  const int count = int(s.close_cells.size());
  while (int(all.size()) < count) all.push_back(int(all.size()));
  with_vertices.clear(), with_edges.clear();
  if (count) std::memset(wait, 0, sizeof(*wait) * count);
  Pairs<T> p;
  auto now=[]{timespec t; clock_gettime(CLOCK_THREAD_CPUTIME_ID,&t); return t.tv_sec+1e-9*t.tv_nsec;}; double t0=now();
  for (int first = 0; first < count; first += n) {
    get_pairs(s, all.data() + first, count - first, p);
    const V<T> a = clear<T>(p.x[0], p.x[1]), b = clear<T>(p.x[1], p.x[0]), apart = (a > b ? a : b) - p.going;
    const unsigned near = less<T>(apart, V<T>{} + (vertices.reach + skin));
    const unsigned nearer = less<T>(apart, V<T>{} + (edges.reach + skin));
    for (int l = 0; l < n && first + l < count; ++l) {
      if (near >> l & 1) with_vertices.push_back(first + l);
      if (nearer >> l & 1) with_edges.push_back(first + l);
    }
  }
  double t1=now(); dbg_t[0]=std::min(dbg_t[0],t1-t0); dbg_t[4]=with_vertices.size(); dbg_t[5]=with_edges.size();
  const V<T> one = V<T>{} + T(1), most = V<T>{} + T(kMostSteps);
  // Parts k to k + many of the pairs in `list`, of which distance(p, i) is the i-th.
  const auto tests = [&](const std::vector<int>& list, const Looking<T>& how, int k, int many, const auto& distance) {
    for (int first = 0; first < int(list.size()); first += n) {
      const int left = int(list.size()) - first;
      get_pairs(s, list.data() + first, left, p);
      const V<T> limit = p.going + (how.reach + skin), limit2 = limit * limit;
      const V<T> rate = reciprocal(p.going * (how.h / time) + how.haste * how.h);
      for (int i = 0; i < many; ++i) {
        const V3<T> d = distance(i);
        const V<T> d2 = dot(d, d) + tiny<T>;
        unsigned found = less<T>(d2, limit2);
        if (left < n) found &= (1u << left) - 1;
        if (!found) continue;
        const V<T> w = (d2 * rsqrt(d2) - how.danger) * rate, steps = w < one ? one : (w > most ? most : w);
        for (; found; found &= found - 1) {
          const int l = __builtin_ctz(found);
          std::uint8_t* const to = wait[list[first + l]];
          to[k + i] = std::uint8_t(steps[l]), to[kParts + (k > 0)] = 1;
        }
      }
    }
  };
  tests(with_vertices, vertices, 0, kVertexParts, [&](int i) __attribute__((always_inline)) {
    const V3<T>&v = p.x[i / 2][0], (&t)[4] = p.x[1 - i / 2], &b = t[i % 2 ? 3 : 2], &c = t[i % 2 ? 1 : 3];
    return apart(of_triangle<T>(v, t[0], b, c), v, t[0], b, c);
  });
  double t2=now(); dbg_t[1]=std::min(dbg_t[1],t2-t1);
  tests(with_edges, edges, kVertexParts, kParts - kVertexParts, [&](int i) __attribute__((always_inline)) {
    const V3<T>&a = p.x[0][0], &b = p.x[0][i / 3 + 1], &c = p.x[1][0], &d = p.x[1][i % 3 + 1];
    return apart(of_edges<T>(a, b, c, d), a, b, c, d);
  });
  dbg_t[2]=std::min(dbg_t[2],now()-t2);
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
