// Springs with their dashpots: what the eight edges at each of a thread's vertices do in a substep.
#pragma once
#include "../sheet/yielding.hpp"
#include "block.hpp"
#include "shared.hpp"

namespace minicloth {
namespace LANES {
namespace {

// The change of velocities in a kick of dt: dv/dt = a - drag v, exact for a constant a.
inline Kick kick_of(const CardSheet& s, const CardCloth& m, double dt) {
  const double lost = m.drag * dt, lag = lost > 0 ? -expm1(-lost) / m.drag : dt;
  return {float(lag / m.density), float(exp(-lost)), float(lag * s.gravity)};
}

struct Edge {
  float k, length;
};

// What an edge pulls with, over its length; `from` and `to` are its ends' positions and later ones.
template <bool kSimple>
__attribute__((always_inline)) inline float edge_pull(const CardCloth& m, const Edge& edge, const Point& from,
                                                      const Point& to) {
  const V3<float> e = to.b - from.b;
  if constexpr (kSimple)
    return edge.k - edge.k * edge.length * rsqrt(square<float>(e));
  else
    return yielding_pull<float>(to.a - from.a, e, edge.k, edge.length,
                                {m.yields, m.buckled, m.buckling, m.shortened_damping});
}

// What springs pull a vertex to: the force is to - over * x, where `over` sums what they pull with over their length.
struct Sum {
  V3<float> to = {0, 0, 0};
  float over = 0;
  void add(float pull, const V3<float>& end) { to = to + pull * end, over += pull; }
};

// Of a thread's vertices: springs, of positions `a` and later ones `b` in shared memory, the held forces and weight
// change velocities. Row by row the neighbours to the left and right are read once, for the vertices above, beside and
// below. Nothing branches: an edge that is not there pulls with 0, and vertices below the last row rest at the origin.
template <bool kSimple, int kStrip>
__attribute__((always_inline)) inline void kick_strip(const CardSheet& s, const Shared& shared, const Kick& kick,
                                                      Own<kStrip>& own) {
  const CardCloth& m = *shared.cloth;
  const double a = s.row_length, b = s.col_length;
  const int c = own.col, cols = s.cols;
  const bool has_left = c > 0 || s.periodic, has_right = c < cols - 1 || s.periodic;
  const int left = c > 0 ? -1 : s.periodic ? cols - 1 : 0, right = c < cols - 1 ? 1 : s.periodic ? 1 - cols : 0;
  const bool border = !s.periodic && (c == 0 || c == cols - 1);
  const float along = m.stretch * float(a / b), shear = m.shear * float((a * a + b * b) / (2 * a * b));
  const Edge down = {m.stretch * float(border ? 0.5 * b / a : b / a), float(a)};
  const Edge cross[2] = {{has_left ? shear : 0.0f, float(s.diagonal)}, {has_right ? shear : 0.0f, float(s.diagonal)}};
  const float area = float((border ? 2 : 1) / (a * b));
  const auto mine = [&](int j) { return Point{own.x[j], own.x[j] + m.damping * own.v[j]}; };

  Sum sums[3];  // of the vertices above, beside and below the row that is read
  Point above, beside = shared.at(s, place(s, own, -1));
#pragma unroll
  for (int q = -1; q <= kStrip; ++q) {
    const float from_above = linked(s, own, q), to_below = linked(s, own, q + 1);  // 1 or 0
    const Point below = q + 1 < kStrip ? mine(q + 1 < kStrip ? q + 1 : 0) : shared.at(s, place(s, own, q + 1));
    if (q > -1) {
      const float pull = from_above * edge_pull<kSimple>(m, down, above, beside);
      if (q > 0) sums[0].add(pull, beside.a);
      if (q < kStrip) sums[1].add(pull, above.a);
    }
#pragma unroll
    for (int side = 0; side < 2; ++side) {
      const Point end = shared.at(s, place(s, own, q) + (side ? right : left));
      const float half = inner(s, own, q) ? along : 0.5f * along;
      const Edge flat = {(side ? has_right : has_left) ? half : 0.0f, float(b)};
      if (q > 0) sums[0].add(from_above * edge_pull<kSimple>(m, cross[side], above, end), end.a);
      if (q > -1 && q < kStrip) sums[1].add(edge_pull<kSimple>(m, flat, beside, end), end.a);
      if (q + 1 < kStrip) sums[2].add(to_below * edge_pull<kSimple>(m, cross[side], below, end), end.a);
    }
    if (q > 0) {
      const int j = q - 1;  // of the vertex above, whose edges are all there now
      const float rate = kick.accelerate * (inner(s, own, j) ? area : 2 * area);
      const V3<float> force = (sums[0].to - sums[0].over * above.a) + shared.force(s, place(s, own, j));
      const V3<float> v = kick.decay * own.v[j] + rate * force;
      if (there(s, own, j)) own.v[j] = {v.x, v.y, v.z - kick.fall};
    }
    in_order();
    above = beside, beside = below;
    sums[0] = sums[1], sums[1] = sums[2], sums[2] = Sum{};
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
