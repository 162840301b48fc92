// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>
#include <cstdlib>
#include <cstring>

#include "distance.hpp"
#include "near.hpp"

namespace minicloth {
namespace LANES {
namespace {

constexpr double kFar = 1e9;     // m
constexpr double kFlat = 0.35;   // least part of the rest area that cells of flat blocks have along a common normal
constexpr double kSmall = 0.3;   // of the rest area, of cells whose normals tell little
constexpr double kFold = 0.2;    // least cosine between neighbours' normals where cells up to kApart apart do not meet
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

// Joins cells i + c and j + c: the cosine between their normals to both; -1 where one of them is small.
template <class T>
void join(Sweep<T>& s, std::size_t i, std::size_t j, int count) {
  const T *const x = s.normal.data(), *const y = x + s.plane, *const z = y + s.plane;
  T* const smooth = s.smooth.data();
  const auto cosine = [&](std::size_t a, std::size_t b) __attribute__((always_inline)) {
    const T d = x[a] * x[b] + (y[a] * y[b] + z[a] * z[b]);
    const T m = x[a] * x[a] + (y[a] * y[a] + z[a] * z[a]), n = x[b] * x[b] + (y[b] * y[b] + z[b] * z[b]);
    const T small = T(kSmall * kSmall), fold = T(kFold * kFold);
    return (m > small && n > small && d > T(0) && d * d > fold * m * n) ? T(1) : T(-1);
  };
#pragma GCC ivdep
  for (int c = 0; c < count; ++c) smooth[i + c] = lesser(smooth[i + c], cosine(i + c, j + c));
#pragma GCC ivdep
  for (int c = 0; c < count; ++c) smooth[j + c] = lesser(smooth[j + c], cosine(i + c, j + c));
}

// Lowest or highest, columnwise, of rows r0 to r1 of a plane.
template <class T>
void columns(const T* plane, int cols, int r0, int r1, bool low, T* to) {
  std::copy_n(plane + std::size_t(r0) * cols, cols, to);
  for (int r = r0 + 1; r < r1; ++r) {
    const T* const row = plane + std::size_t(r) * cols;
    if (low)
      for (int c = 0; c < cols; ++c) to[c] = lesser(to[c], row[c]);
    else
      for (int c = 0; c < cols; ++c) to[c] = greater(to[c], row[c]);
  }
}

// Lowest (or highest) of a plane's `rows` x `cols` first numbers in every block, which is `more` rows and columns larger
// than its cells, to a plane of blocks.
template <class T>
void to_blocks(const Sweep<T>& s, const T* plane, int rows, int cols, int more, bool low, T* out) {
  thread_local std::vector<T> line;
  line.resize(s.cols + 1);
  std::fill_n(out, s.blocks, T(low ? kFar : -kFar));
  const int most = s.periodic && more ? cols + 1 : cols;
  for (int b = 0; b < s.block_rows; ++b) {
    const int r0 = b * kSide, r1 = std::min(r0 + kSide + more, rows);
    if (r1 <= r0) continue;
    columns(plane, s.cols, r0, r1, low, line.data());
    line[s.cols] = line[0];
    const int first = b / kSide * s.group_cols * kCells + b % kSide * kSide;
    for (int a = 0; a < s.block_cols; ++a) {
      const int c0 = a * kSide, c1 = std::min(c0 + kSide + more, most);
      T v = T(low ? kFar : -kFar);
      for (int c = c0; c < c1; ++c) v = low ? lesser(v, line[c]) : greater(v, line[c]);
      out[first + a / kSide * kCells + a % kSide] = v;
    }
  }
}

template <class T>
void boxes(Sweep<T>& s, T cell_area) {
  const int cols = s.cols, last = cols - 1, across = s.periodic ? cols : last;
  const T unit = T(0.5) / cell_area;
  for (int r = 0; r + 1 < s.rows; ++r) {
    row_of_normals(s, r, 0, last, 1, unit);
    if (s.periodic) row_of_normals(s, r, last, cols, -last, unit);
  }
  std::fill(s.smooth.begin(), s.smooth.end(), T(1));
  for (int r = 0; r + 1 < s.rows; ++r) {
    const std::size_t i = std::size_t(r) * cols;
    join(s, i, i + 1, across - 1);
    if (s.periodic) join(s, i, i + last, 1);
    if (r + 2 < s.rows) join(s, i, i + cols, across);
  }
  for (int k = 0; k < 6; ++k) {
    T *const block = s.block.data() + k * s.blocks, *const cone = s.cone.data() + k * s.blocks;
    to_blocks(s, s.now.data() + k % 3 * s.plane, s.rows, cols, 1, k < 3, block);
    to_blocks(s, s.then.data() + k % 3 * s.plane, s.rows, cols, 1, k < 3, block + 6 * s.blocks);
    to_blocks(s, s.normal.data() + k % 3 * s.plane, s.rows - 1, across, 0, k < 3, cone);
  }
  for (int g = 0; g < s.groups; ++g)
    for (int k = 0; k < kBox; ++k) {
      const T* const from = s.block.data() + std::size_t(k) * s.blocks + g * kCells;
      T v = from[0];
      for (int i = 1; i < kCells; ++i) v = k / 3 % 2 ? greater(v, from[i]) : lesser(v, from[i]);
      s.group[g * kBox + k] = v;
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

// Which of a vector of boxes, planes `stride` apart, come near the box a, which reach has grown.
template <class T>
inline unsigned meet(const T* a, std::size_t step, const T* b, std::size_t stride) {
  unsigned near = ~0u;
  for (int k = 0; k < 3; ++k) {
    const auto get = [&](int i) { return load(b + (k + i) * stride); };
    const auto mine = [&](int i) { return V<T>{} + a[(k + i) * step]; };
    near &= (less<T>(get(0), mine(3)) | less<T>(get(6), mine(9))) & (less<T>(mine(0), get(3)) | less<T>(mine(6), get(9)));
    if (!near) break;
  }
  return near;
}
template <class T>
inline bool meet(const T (&a)[kBox], const T* b) {
  for (int k = 0; k < 3; ++k)
    if ((b[k] >= a[3 + k] && b[6 + k] >= a[9 + k]) || (b[3 + k] <= a[k] && b[9 + k] <= a[6 + k])) return false;
  return true;
}
template <class T>
inline void grown(const T* from, std::size_t stride, T reach, T (&to)[kBox]) {
  for (int k = 0; k < kBox; ++k) to[k] = from[k * stride] + (k / 3 % 2 ? reach : -reach);
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

// Whether two cells or blocks that start at cells i and j lie at most `apart` cells from each other in the grid.
template <class T>
inline bool beside(const Sweep<T>& s, int i, int j, int apart) {
  const int dr = std::abs(s.row[i] - s.row[j]);
  int dc = std::abs(s.col[i] - s.col[j]);
  if (s.periodic) dc = std::min(dc, s.cols - dc);
  return dr <= apart && dc <= apart;
}

template <class T>
void blocks(Sweep<T>& s, T reach) {
  constexpr int n = kLanes<T>;
  s.close_blocks.clear();
  for (int g = 0; g < s.groups; ++g)
    for (int h = g; h < s.groups; ++h) {
      T all[kBox], mine[kBox];
      grown(s.group.data() + h * kBox, 1, reach, all);
      if (!meet(all, s.group.data() + g * kBox)) continue;
      unsigned some = 0;
      for (int k = 0; k < kCells; k += n) some |= meet<T>(all, 1, s.block.data() + g * kCells + k, s.blocks) << k;
      for (; some; some &= some - 1) {
        const int a = g * kCells + __builtin_ctz(some);
        grown(s.block.data() + a, s.blocks, reach, mine);
        for (int k = 0; k < kCells; k += n)
          for (unsigned found = meet<T>(mine, 1, s.block.data() + h * kCells + k, s.blocks); found; found &= found - 1) {
            const int b = h * kCells + k + __builtin_ctz(found);
            if (b < a || (beside(s, s.at[a], s.at[b], kSide + (s.periodic ? kSide - 1 : 0)) && flat(s, a, b))) continue;
            s.close_blocks.push_back({a, b});
          }
      }
    }
}

template <class T>
inline T middle(const T (&x)[4], T* half) {
  const T lo = lesser(lesser(x[0], x[1]), lesser(x[2], x[3])), hi = greater(greater(x[0], x[1]), greater(x[2], x[3]));
  *half = (hi - lo) / 2;
  return (lo + hi) / 2;
}

template <class T>
void record(Sweep<T>& s, int cell) {
  T* const to = s.records.data() + std::size_t(kRecord) * cell;
  const int at[4] = {s.corner[0][cell], s.corner[1][cell], s.corner[2][cell], s.corner[3][cell]};
  T spread = 0;
  for (int k = 0; k < 3; ++k) {
    const T *const x = s.now.data() + k * s.plane, *const y = s.then.data() + k * s.plane;
    T ways[4], half;
    for (int q = 0; q < 4; ++q) to[3 * q + k] = x[at[q]], ways[q] = y[at[q]] - x[at[q]];
    to[12 + k] = middle(ways, &half);
    spread += half * half;
  }
  to[15] = std::sqrt(spread);
}

// The boxes of a block's cells side by side; where there are none they are empty.
template <class T>
const T* slots(Sweep<T>& s, int block) {
  typedef T Four __attribute__((vector_size(4 * sizeof(T))));
  T* const to = s.slots.data() + std::size_t(block) * kBox * kCells;
  if (s.filled[block]) return to;
  s.filled[block] = 1;
  const int first = s.at[block], rows = std::min(kSide, s.rows - s.row[first]);
  const int cols = std::min(kSide, s.cols - s.col[first]);
  unsigned even = 0;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < cols; ++c) {
      even |= unsigned(s.smooth[first + r * s.cols + c] > T(0)) << (r * kSide + c);
      record(s, first + r * s.cols + c);
    }
  s.even[block] = std::uint16_t(even);
  const auto four = [](const T* p) {
    Four v;
    std::memcpy(&v, p, sizeof v);
    return v;
  };
  const int across = s.corner[1][first + cols - 1] - (first + cols - 1);
  for (int r = 0; r < kSide; ++r) {
    const int cell = first + std::min(r, rows - 1) * s.cols, down = s.corner[2][cell] - cell;
    for (int k = 0; k < 6; ++k) {
      const T* const x = (k < 3 ? s.now : s.then).data() + k % 3 * s.plane + cell;
      T *const lo = to + (k + k / 3 * 3) * kCells + r * kSide, *const hi = lo + 3 * kCells;
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

// Of cell i of a block the cells up to kApart apart in a block dr, dc blocks further (-1, 0 or 1).
unsigned nearby(int i, int dr, int dc) {
  unsigned found = 0;
  for (int j = 0; j < kCells; ++j) {
    const int r = dr * kSide + j / kSide - i / kSide, c = dc * kSide + j % kSide - i % kSide;
    if (std::abs(r) <= kApart && std::abs(c) <= kApart) found |= 1u << j;
  }
  return found;
}
struct Nearby {
  std::uint16_t mask[3][3][kCells];
  Nearby() {
    for (int dr = -1; dr < 2; ++dr)
      for (int dc = -1; dc < 2; ++dc)
        for (int i = 0; i < kCells; ++i) mask[dr + 1][dc + 1][i] = std::uint16_t(nearby(i, dr, dc));
  }
};

template <class T>
void cells(Sweep<T>& s, T reach) {
  constexpr int n = kLanes<T>;
  std::fill(s.filled.begin(), s.filled.end(), 0);
  s.close_cells.clear();
  static const Nearby nearby;
  for (const auto& [a, b] : s.close_blocks) {
    const T *const first = slots(s, a), *const second = slots(s, b);
    T all[kBox], mine[kBox];
    grown(s.block.data() + b, s.blocks, reach, all);
    const int dr = (s.row[s.at[b]] - s.row[s.at[a]]) / kSide, dc = (s.col[s.at[b]] - s.col[s.at[a]]) / kSide;
    const std::uint16_t* const around = std::abs(dr) <= 1 && std::abs(dc) <= 1 ? nearby.mask[dr + 1][dc + 1] : nullptr;
    unsigned some = 0, those = 0;
    for (int k = 0; k < kCells; k += n) some |= meet<T>(all, 1, first + k, kCells) << k;
    grown(s.block.data() + a, s.blocks, reach, all);
    for (int k = 0; some && k < kCells; k += n) those |= meet<T>(all, 1, second + k, kCells) << k;
    if (!those) continue;
    for (; some; some &= some - 1) {
      const int i = __builtin_ctz(some), at = s.at[a] + i / kSide * s.cols + i % kSide;
      unsigned wanted = those;
      if (a == b) wanted &= ~1u << i;
      if (around && s.even[a] >> i & 1) wanted &= ~(around[i] & s.even[b]);
      if (!wanted) continue;
      grown(first + i, kCells, reach, mine);
      unsigned found = 0;
      for (int k = 0; k < kCells; k += n) found |= meet<T>(mine, 1, second + k, kCells) << k;
      for (found &= wanted; found; found &= found - 1) {
        const int j = __builtin_ctz(found), to = s.at[b] + j / kSide * s.cols + j % kSide;
        if (s.periodic && lesser(s.smooth[at], s.smooth[to]) > T(0) && beside(s, at, to, kApart)) continue;
        s.close_cells.push_back({at, to});
      }
    }
  }
}

template <class T>
inline V<T> gather(const T* base, const int* at) {
  V<T> v;
  for (int k = 0; k < kLanes<T>; ++k) v[k] = base[at[k]];
  return v;
}
#if defined(__AVX512F__)
template <>
inline V<float> gather(const float* base, const int* at) {
  return (V<float>)_mm512_i32gather_ps(_mm512_loadu_si512(at), base, 4);
}
#elif defined(__AVX2__)
template <>
inline V<float> gather(const float* base, const int* at) {
  return (V<float>)_mm256_i32gather_ps(base, _mm256_loadu_si256((const __m256i*)at), 4);
}
#endif

// Vector k of `to` gets number k of every record.
template <class T>
inline void transpose(const T* const (&from)[kLanes<T>], V<T> (&to)[kRecord]) {
  constexpr int n = kLanes<T>;
  using Index = decltype(V<T>{} < V<T>{});
  for (int part = 0; part < kRecord; part += n) {
    V<T> row[n];
    for (int l = 0; l < n; ++l) row[l] = load(from[l] + part);
    // Swaps blocks of `size` numbers across the diagonal, then halves them.
    for (int size = n / 2; size >= 1; size /= 2) {
      Index low, high;
      for (int k = 0; k < n; ++k) low[k] = k & size ? n + k - size : k, high[k] = k & size ? n + k : k + size;
      for (int l = 0; l < n; ++l)
        if (!(l & size)) {
          const V<T> a = row[l], b = row[l + size];
          row[l] = pick(a, b, low), row[l + size] = pick(a, b, high);
        }
    }
    for (int k = 0; k < n; ++k) to[part + k] = row[k];
  }
}

template <class T>
void parts(const Sweep<T>& s, const std::pair<int, int>* pairs, int count, const Looking<T>& vertices,
           const Looking<T>& edges, T skin, T time, std::uint8_t (*wait)[kParts]) {
  constexpr int n = kLanes<T>;
  const V<T> none = {}, one = none + T(1), most = none + T(kMostSteps);
  for (int first = 0; first < count; first += n) {
    V<T> field[2][kRecord];
    for (int half = 0; half < 2; ++half) {
      const T* from[n];
      for (int l = 0; l < n; ++l) {
        const auto& pair = pairs[std::min(first + l, count - 1)];
        from[l] = s.records.data() + std::size_t(kRecord) * (half ? pair.second : pair.first);
      }
      transpose<T>(from, field[half]);
    }
    V3<T> p[2][4];
    for (int half = 0; half < 2; ++half)
      for (int q = 0; q < 4; ++q) p[half][q] = {field[half][3 * q], field[half][3 * q + 1], field[half][3 * q + 2]};
    // How far they can go towards each other.
    const V3<T> way = {field[0][12] - field[1][12], field[0][13] - field[1][13], field[0][14] - field[1][14]};
    const V<T> square = dot(way, way) + tiny<T>, going = square * rsqrt(square) + (field[0][15] + field[1][15]);
    const V<T> vertex = going + (vertices.reach + skin), edge = going + (edges.reach + skin);
    const V<T> vertex2 = vertex * vertex, edge2 = edge * edge, rate = T(1) / (going * (vertices.h / time) + vertices.haste * vertices.h);
    alignas(64) T steps[kParts][n];
    unsigned close[13];
    const auto note = [&](const V3<T>& d, const V<T>& limit, T danger, int k) {
      const V<T> d2 = dot(d, d), far = d2 * rsqrt(d2 + tiny<T>), w = (far - danger) * rate;
      const V<T> some = w < one ? one : (w > most ? most : w);
      store<T>(steps[k], some), close[k] = less<T>(d2, limit);
    };
    for (int half = 0; half < 2; ++half) {
      const V3<T>& v = p[half][0];
      const V3<T>(&t)[4] = p[1 - half];
      for (int k = 0; k < 2; ++k) {
        const V3<T>&b = t[k ? 3 : 2], &c = t[k ? 1 : 3];
        note(apart(of_triangle<T>(v, t[0], b, c), v, t[0], b, c), vertex2, vertices.danger, 2 * half + k);
      }
    }
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b) {
        const V3<T>(&i)[4] = p[0], (&j)[4] = p[1];
        const Nearest<T> near = of_edges<T>(i[0], i[a + 1], j[0], j[b + 1]);
        note(apart(near, i[0], i[a + 1], j[0], j[b + 1]), edge2, edges.danger, 4 + 3 * a + b);
      }
    for (int l = 0; l < n && first + l < count; ++l) std::memset(wait[first + l], 0, kParts);
    for (int k = 0; k < 13; ++k)
      for (unsigned found = close[k]; found; found &= found - 1) {
        const int l = __builtin_ctz(found);
        if (first + l >= count) break;
        wait[first + l][k] = std::uint8_t(steps[k][l]), wait[first + l][k < 4 ? 14 : 15] = 1;
      }
  }
}

template <class T>
void look(const T* x, const T* v, int width, const int (*parts)[4], const int* which, int count, bool edges,
          const Looking<T>& how, std::uint8_t* wait) {
  constexpr int n = kLanes<T>;
  const V<T> none = {}, one = none + T(1), most = none + T(kMostSteps);
  const T rate = 1 / how.h;
  for (int first = 0; first < count; first += n) {
    alignas(64) int at[4][n];
    for (int l = 0; l < n; ++l) {
      const int(&part)[4] = parts[which[std::min(first + l, count - 1)]];
      for (int q = 0; q < 4; ++q) at[q][l] = part[q];
    }
    V3<T> p[4], w[4];
    for (int q = 0; q < 4; ++q) {
      p[q] = {gather<T>(x, at[q]), gather<T>(x + width, at[q]), gather<T>(x + 2 * width, at[q])};
      w[q] = {gather<T>(v, at[q]), gather<T>(v + width, at[q]), gather<T>(v + 2 * width, at[q])};
    }
    const Nearest<T> near = edges ? of_edges<T>(p[0], p[1], p[2], p[3]) : of_triangle<T>(p[0], p[1], p[2], p[3]);
    const V3<T> d = apart(near, p[0], p[1], p[2], p[3]), u = apart(near, w[0], w[1], w[2], w[3]);
    const V<T> d2 = dot(d, d) + tiny<T>, inverse = rsqrt(d2), far = d2 * inverse, un = inverse * dot(u, d);
    const V<T> closing = un < none ? -un : none, room = far - how.danger;
    V<T> steps = (rate * room) / (closing + how.haste);
    steps = steps < one ? one : (steps > most ? most : steps);
    const V<T> gap = far - how.reach;
    const auto act = gap < closing * (how.h * steps);
    for (int l = 0; l < n && first + l < count; ++l) wait[first + l] = std::uint8_t(int(steps[l]) | (act[l] ? kAct : 0));
  }
}

template <class T>
void drift(const T* x, const T* x0, const T* v0, int rows, int cols, std::ptrdiff_t stride, const T* since, T* most) {
  constexpr int n = kLanes<T>, q = 3 * n;
  const V<T> t = load(since);
  V<T> high = {};
  for (int r = 0; r < rows; ++r, x += stride, x0 += stride, v0 += stride)
    for (int i = 0; i < cols * q; i += q) {
      V<T> d2 = {};
      for (int k = 0; k < q; k += n) {
        const V<T> d = load(x + i + k) - (load(x0 + i + k) + t * load(v0 + i + k));
        d2 += d * d;
      }
      high = d2 > high ? d2 : high;
    }
  store<T>(most, high);
}

template <class T>
const NearLanes<T> instance = {boxes<T>, blocks<T>, cells<T>, parts<T>, look<T>, drift<T>};

}  // namespace
}  // namespace LANES

DEFINE_LANES(NearLanes<float>, instance<float>)
DEFINE_LANES(NearLanes<double>, instance<double>)

}  // namespace minicloth
