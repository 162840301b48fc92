// Bending, the air and pressure at each of a thread's vertices: forces that are held for some substeps.
#pragma once
#include "../sheet/blow.hpp"
#include "block.hpp"
#include "shared.hpp"

namespace minicloth {
namespace LANES {
namespace {

inline Weather weather_of(const CardSheet& s, const double* wind, double pressure) {
  return {float(s.air_normal / 256),
          float(s.air_lift / 256),
          float(s.air_tangential / 256),
          float(s.pressure ? pressure / 12 : 0.0),
          {float(4 * wind[0]), float(4 * wind[1]), float(4 * wind[2])}};
}

// What all corners of a cell feel alike: of the air, and of pressure p / 12 times twice the cell's area.
inline Cell on_cell(const CardSheet& s, const Weather& w, const Point& upper_left, const Point& upper_right,
                    const Point& lower_left, const Point& lower_right) {
  const V3<float> area = cross(lower_right.a - upper_left.a, upper_right.a - lower_left.a);
  Cell all = {{0, 0, 0}, 0};
  if (s.air) {
    const V3<float> sum = (upper_left.b + lower_left.b) + (upper_right.b + lower_right.b);
    const Blown<float> blown = air_force<float>(area, sum, w.wind, w);
    all.to = blown.to, all.over = blown.over;
  }
  if (s.pressure) all.to = all.to + w.pressure * area;
  return all;
}

// Of positions `a` and velocities `b` in shared memory: the bending (Bergou et al. 2006) of a thread's vertices, from
// second differences along rows and columns and mixed ones of cells; and the cells of which they are the upper left
// corner.
template <int kStrip>
__attribute__((always_inline)) inline void bend_strip(const CardSheet& s, const Shared& shared, Own<kStrip>& own) {
  const CardCloth& m = *shared.cloth;
  const Weather& w = *shared.weather;
  if (own.row >= s.rows) return;
  const double a = s.row_length, b = s.col_length;
  const int cols = s.cols, c = own.col, n = s.rows * cols;
  const bool air = s.air || s.pressure, has_left = c > 0 || s.periodic, has_right = c < cols - 1 || s.periodic;
  const auto wrapped = [&](int col) {
    return (col < 0 ? (s.periodic ? col + cols : 0) : col < cols ? col : s.periodic ? col - cols : cols - 1) - c;
  };
  const int left = wrapped(c - 1), right = wrapped(c + 1), far_left = wrapped(c - 2), far_right = wrapped(c + 2);
  const auto x = [&](int q, int aside) {
    const int i = place(s, own, q) + aside;
    return V3<float>{shared.field[i].a, shared.field[n + i].a, shared.field[2 * n + i].a};
  };
  // Weights of second differences in the middle of which a column, and a row, lies.
  const auto in_row = [&](int col) { return s.periodic || (col > 0 && col < cols - 1); };
  const auto in_col = [&](int q) { return inner(s, own, q); };
  const float row_weight = m.bend * float(a / (b * b * b)), twist = m.bend * m.twist * float(2 / (a * b));
  const float col_weight = m.bend * float((in_row(c) ? 1 : 0.5) * b / (a * a * a));
  const float west = in_row(c - 1) ? row_weight : 0.0f, here = in_row(c) ? row_weight : 0.0f;
  const float east = in_row(c + 1) ? row_weight : 0.0f;
  const float twist_left = has_left ? twist : 0.0f, twist_right = has_right ? twist : 0.0f;

  V3<float> far_up = x(-2, 0), up = x(-1, 0), up_left = x(-1, left);
  V3<float> up_right = x(-1, right);
  Point at = shared.at(s, place(s, own, 0)), beside = shared.at(s, place(s, own, 0) + right);
  V3<float> before = x(0, left);
  Point down = shared.at(s, place(s, own, 1));
#pragma unroll
  for (int j = 0; j < kStrip; ++j) {
    if (j >= whole<kStrip>(s) && own.row + j >= s.rows) break;
    const V3<float> down_left = x(j + 1, left);
    const Point down_right = shared.at(s, place(s, own, j + 1) + right);
    const Point far_down = shared.at(s, place(s, own, j + 2));
    V3<float> force = {0, 0, 0};
    if (s.bends) {
      const float half = in_col(j) ? 1.0f : 0.5f, wl = half * west, w0 = half * here, wr = half * east;
      const float wu = in_col(j - 1) ? col_weight : 0.0f, wv = in_col(j) ? col_weight : 0.0f;
      const float wd = in_col(j + 1) ? col_weight : 0.0f, up_there = linked(s, own, j);
      const float down_there = linked(s, own, j + 1);
      const float ul = up_there * twist_left, ur = up_there * twist_right;
      const float dl = down_there * twist_left, dr = down_there * twist_right;
      V3<float> f = (2 * (w0 + wl) + (ul + dl)) * before + (2 * (w0 + wr) + (ur + dr)) * beside.a;
      f = f + (2 * (wv + wu) + (ul + ur)) * up + (2 * (wv + wd) + (dl + dr)) * down.a;
      f = f - ((4 * w0 + (wl + wr)) + (4 * wv + (wu + wd)) + ((ul + ur) + (dl + dr))) * at.a;
      f = f - wl * x(j, far_left) - wr * x(j, far_right) - wu * far_up - wd * far_down.a;
      force = f - ul * up_left - ur * up_right - dl * down_left - dr * down_right.a;
    }
    if (air) {
      const Cell none = {{0, 0, 0}, 0};
      const bool there = has_right && linked(s, own, j + 1);
      shared.cells[place(s, own, j)] = there ? on_cell(s, w, at, beside, down, down_right) : none;
    }
    if (s.pressure) {  // the triangles of each vertex and its neighbours, which only it feels
      const V3<float> edges[4] = {before - at.a, down.a - at.a, beside.a - at.a, up - at.a};
      const bool over = linked(s, own, j), under = linked(s, own, j + 1);
      const bool there[4] = {has_left && under, has_right && under, has_right && over, has_left && over};
      for (int k = 0; k < 4; ++k)
        if (there[k]) force = force + w.pressure * cross(edges[k], edges[(k + 1) % 4]);
    }
    shared.put_force(s, place(s, own, j), force);
    in_order();
    far_up = up, up = at.a, at = down, down = far_down;
    up_left = before, before = down_left, up_right = beside.a, beside = down_right;
  }
}

// Adds what the cells at a thread's vertices do, whose velocities are `b` in shared memory.
template <int kStrip>
__attribute__((always_inline)) inline void blow_strip(const CardSheet& s, const Shared& shared, Own<kStrip>& own) {
  const int n = s.rows * s.cols, c = own.col, cols = s.cols;
  // The cells to the left and right of its column in a row; to the left of the first one lies none, as does in the
  // last.
  const auto both = [&](int i) {
    const Cell one = shared.cells[i], other = shared.cells[i + (c > 0 ? -1 : cols - 1)];
    return Cell{one.to + other.to, one.over + other.over};
  };
  Cell above = both(own.row > 0 ? place(s, own, -1)
                                : (s.rows - 1) / kStrip * cols + layer<kStrip>(s, (s.rows - 1) % kStrip) +
                                      c);  // in the last row there are none
  for_own(s, own, [&](int j, int i) __attribute__((always_inline)) {
    const Cell below = both(i);
    const V3<float> v = {shared.field[i].b, shared.field[n + i].b, shared.field[2 * n + i].b};
    const V3<float> force = (above.to + below.to) - (above.over + below.over) * v;
    shared.put_force(s, i, shared.force(s, i) + force);
    above = below;
  });
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
