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

// What an edge pulls with, over its length; `d` and `e` lead from one end to the other, of positions and later ones.
template <bool kSimple>
inline float edge_pull(const CardCloth& m, const Edge& edge, const Point& from, const Point& to) {
  const V3<float> e = to.b - from.b;
  if constexpr (kSimple)
    return edge.k - edge.k * edge.length * rsqrt(square<float>(e));
  else
    return yielding_pull<float>(to.a - from.a, e, edge.k, edge.length,
                                {m.yields, m.buckled, m.buckling, m.shortened_damping});
}

// Of a thread's vertices: forces by their springs, of positions `a` and later ones `b` in shared memory, the held ones
// and weight change velocities.
template <bool kSimple, int kStrip>
__attribute__((always_inline)) inline void kick_strip(const CardSheet& s, const CardCloth& m, const Shared& shared,
                                                      const Kick& kick, Own<kStrip>& own) {
  if (own.row >= s.rows) return;
  const double a = s.row_length, b = s.col_length;
  const int c = own.col, cols = s.cols;
  const bool has_left = c > 0 || s.periodic, has_right = c < cols - 1 || s.periodic;
  const int left = c > 0 ? c - 1 : s.periodic ? cols - 1 : c, right = c < cols - 1 ? c + 1 : s.periodic ? 0 : c;
  const bool border = !s.periodic && (c == 0 || c == cols - 1);
  const Edge along = {m.stretch * float(a / b), float(b)};
  const Edge down = {m.stretch * float(border ? 0.5 * b / a : b / a), float(a)};
  const Edge cross = {m.shear * float((a * a + b * b) / (2 * a * b)), float(s.diagonal)};
  const float area = float((border ? 2 : 1) / (a * b));

  const bool above = own.row > 0;
  const int up = (above ? own.row - 1 : 0) * cols;
  const auto mine = [&](int j) { return Point{own.x[j], own.x[j] + m.damping * own.v[j]}; };
  Point left_up = shared.at(s, up + left), right_up = shared.at(s, up + right), at_up = shared.at(s, up + c);
  Point left_at = shared.at(s, own.row * cols + left), right_at = shared.at(s, own.row * cols + right);
  Point at = mine(0);
  float pull_up = above ? edge_pull<kSimple>(m, down, at, at_up) : 0;
#pragma unroll
  for (int j = 0; j < kStrip; ++j) {
    const int row = own.row + j;
    if (row >= s.rows) break;
    const bool below = row < s.rows - 1, inner = row > 0 && below;
    const int next = (below ? row + 1 : row) * cols;
    const Point left_down = shared.at(s, next + left), right_down = shared.at(s, next + right);
    const Point at_down = j + 1 < kStrip && below ? mine(j + 1 < kStrip ? j + 1 : 0) : shared.at(s, next + c);
    const Edge flat = {inner ? along.k : 0.5f * along.k, along.length};

    V3<float> to = pull_up * at_up.a;
    float over = pull_up;
    const auto add = [&](bool there, const Edge& edge, const Point& end) {
      const float pull = there ? edge_pull<kSimple>(m, edge, at, end) : 0.0f;
      to = to + pull * end.a, over += pull;
      return pull;
    };
    add(has_left, flat, left_at), add(has_right, flat, right_at);
    add(has_left && row > 0, cross, left_up), add(has_right && row > 0, cross, right_up);
    add(has_left && below, cross, left_down), add(has_right && below, cross, right_down);
    pull_up = add(below, down, at_down);

    const float rate = kick.accelerate * (inner ? area : 2 * area);
    const V3<float> force = (to - over * at.a) + own.slow[j];
    const V3<float> v = kick.decay * own.v[j] + rate * force;
    own.v[j] = {v.x, v.y, v.z - kick.fall};
    at_up = at, at = at_down;
    left_up = left_at, left_at = left_down, right_up = right_at, right_at = right_down;
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
