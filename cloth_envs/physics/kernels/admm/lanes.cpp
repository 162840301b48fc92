// Compiled once per instruction set; LANES names the namespace.
#include "../base/simd.hpp"
#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

template <class T>
void rest(const Geometry<T>& g, T a, T* const (&x)[3], T* const (&out)[4]) {
  const int s = g.stride, to[4] = {1, s, s + 1, s - 1};
  const T length[4] = {g.col_length, g.row_length, g.diagonal, g.diagonal};
  const T share = 1 / (1 + a);
  for (int e = 0; e < 4; ++e)
    for (int i = g.begin; i < g.end; i += kLanes<T>) {
      const V3<T> d = at(x, i + to[e]) - at(x, i);
      const V<T> square = dot(d, d) + tiny<T>;
      store(out[e] + i, share * (length[e] + a * (square * rsqrt(square))));
    }
}

// For every edge y = d + u and u <- y (1 - L/|y|) / (1 + w): the prox of the spring, z = y - u, for a weight of w
// times its stiffness. Its share of D^T W^2 (z - u - d) is then w k (u before - 2 u after), away from each end.
template <class T, bool kBending>
void local(const Geometry<T>& g, const LocalTerms<T>& p, const T* area, T* const (&goal)[3], T* const (&x)[3],
           const EdgePlanes<T>& u, T* const (&rest)[4], T* const (&tail)[9], T* const (&residual)[3]) {
  const int s = g.stride;
  const T *along = g.along.data(), *down = g.down.data(), *right = g.right.data(), *left = g.left.data();
  const T *along_near = g.along_near.data(), *down_near = g.down_near.data();
  const T *along_far = g.along_far.data(), *down_far = g.down_far.data();
  const T stretch = p.stretch, shear = p.shear, bend = p.bend, shrink = p.shrink, inertia = p.inertia;
  T* const souths[3] = {tail[0], tail[1], tail[2]};
  T* const rights[3] = {tail[3], tail[4], tail[5]};
  T* const lefts[3] = {tail[6], tail[7], tail[8]};
  V3<T> previous = {};
  for (int i = g.begin; i < g.end; i += kLanes<T>) {
    const V3<T> here = at(x, i);
    const auto edge = [&](int e, int j, const V<T>& k, const V<T>& linear) __attribute__((always_inline)) {
      const V3<T> d = at(x, j) - here, before = at(u.p[e], i), y = d + before;
      const V<T> inverse = rsqrt(y.x * y.x + (y.y * y.y + (y.z * y.z + tiny<T>)));
      const V3<T> after = (shrink - shrink * load(rest[e] + i) * inverse) * y;
      put(u.p[e], i, after);
      const V3<T> pull = k * ((after - before) + after);
      if constexpr (kBending) return pull + linear * d;
      return pull;
    };
    const V<T> none = {}, a = load(along + i), b = load(down + i), r = load(right + i), l = load(left + i);
    const auto east = edge(0, i + 1, stretch * a, kBending ? bend * load(along_near + i) + p.twist_along * a : none);
    V3<T> f = east - V3<T>{late(previous.x, east.x), late(previous.y, east.y), late(previous.z, east.z)};
    previous = east;
    const auto south = edge(1, i + s, stretch * b, kBending ? bend * load(down_near + i) + p.twist_down * b : none);
    put(souths, i, south);
    f = f + (south - at(souths, i - s));
    const auto south_east = edge(2, i + s + 1, shear * r, kBending ? p.twist_diagonal * r : none);
    put(rights, i, south_east);
    f = f + (south_east - at(rights, i - s - 1));
    const auto south_west = edge(3, i + s - 1, shear * l, kBending ? p.twist_diagonal * l : none);
    put(lefts, i, south_west);
    f = f + (south_west - at(lefts, i - s + 1));
    if constexpr (kBending) {
      const auto far = [&](int j, const T* weight)
                           __attribute__((always_inline)) { return load(weight) * (at(x, j) - here); };
      f = f + (none + bend) * ((far(i + 2, along_far + i) + far(i - 2, along_far + i - 2)) +
                               (far(i + 2 * s, down_far + i) + far(i - 2 * s, down_far + i - 2 * s)));
    }
    put(residual, i, f + (inertia * load(area + i)) * (at(goal, i) - here));
  }
}

template <class T>
void local_any(const Geometry<T>& g, const LocalTerms<T>& p, const T* area, T* const (&goal)[3], T* const (&x)[3],
               const EdgePlanes<T>& u, T* const (&rest)[4], T* const (&tail)[9], T* const (&residual)[3]) {
  (p.bend > 0 ? local<T, true> : local<T, false>)(g, p, area, goal, x, u, rest, tail, residual);
}

// kRows rows by kCols vectors of a product.
template <class T, int kRows, int kCols>
inline void block(int k, const T* a, int row, int col, const T* b, int ldb, T* c, int ldc) {
  V<T> sum[kRows][kCols] = {};
  for (int j = 0; j < k; ++j, a += col, b += ldb) {
    V<T> line[kCols];
    for (int n = 0; n < kCols; ++n) line[n] = load(b + n * kLanes<T>);
    for (int m = 0; m < kRows; ++m)
      for (int n = 0; n < kCols; ++n) sum[m][n] += a[m * row] * line[n];
  }
  for (int m = 0; m < kRows; ++m)
    for (int n = 0; n < kCols; ++n) store(c + m * ldc + n * kLanes<T>, sum[m][n]);
}
template <class T, int kCols>
inline void columns(int m, int k, const T* a, int row, int col, const T* b, int ldb, T* c, int ldc) {
  constexpr int kRows = kBytes == 64 ? 8 : 4;
  int i = 0;
  for (; i + kRows <= m; i += kRows) block<T, kRows, kCols>(k, a + i * row, row, col, b, ldb, c + i * ldc, ldc);
  for (; i + 2 <= m; i += 2) block<T, 2, kCols>(k, a + i * row, row, col, b, ldb, c + i * ldc, ldc);
  for (; i < m; ++i) block<T, 1, kCols>(k, a + i * row, row, col, b, ldb, c + i * ldc, ldc);
}
template <class T>
void multiply(int m, int k, int n, const T* a, int row, int col, const T* b, int ldb, T* c, int ldc) {
  int j = 0;
  for (; j + 3 * kLanes<T> <= n; j += 3 * kLanes<T>) columns<T, 3>(m, k, a, row, col, b + j, ldb, c + j, ldc);
  for (; j + 2 * kLanes<T> <= n; j += 2 * kLanes<T>) columns<T, 2>(m, k, a, row, col, b + j, ldb, c + j, ldc);
  for (; j < n; j += kLanes<T>) columns<T, 1>(m, k, a, row, col, b + j, ldb, c + j, ldc);
}

template <class T>
const AdmmLanes<T> table = {rest<T>, local_any<T>, slowed_air_and_pressure<T>, multiply<T>};

}  // namespace
}  // namespace LANES

DEFINE_LANES(AdmmLanes<float>, table<float>)
DEFINE_LANES(AdmmLanes<double>, table<double>)

}  // namespace minicloth
