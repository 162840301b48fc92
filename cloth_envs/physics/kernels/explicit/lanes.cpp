// Compiled once per instruction set; LANES names the namespace.
#include <algorithm>

#include "../base/simd.hpp"
#include "../sheet/contact.hpp"
#include "core.hpp"

namespace minicloth {
namespace LANES {
namespace {

// One substep. Every edge is evaluated once, by f = k (1 - L/|d|) d + c (d.w)/|d|^2 d with c = damping * k (shortened
// ones may have less of the first and more of the second term) and the share of quadratic bending that lies on it, at
// the vertex that it leaves towards column + 1, row + 1 or a diagonal. It arrives one lane later (along) or about a row
// later, through memory; where rows are shorter than a vector, once all edges have left.
template <class T, bool kYields, bool kAir>
void step(const Geometry<T>& g, const StepTerms<T>& p, const Planes<T>& in, const Planes<T>& out, const Cells<T>& air,
          const Edges<T>& edges) {
  const int s = g.stride;
  const T stretch = p.stretch, shear = p.shear, bend = p.bend, damping = p.damping;
  const T yields = p.yields, buckled = p.buckled, buckling = p.buckling, shortened_damping = p.shortened_damping;
  const T col_length = g.col_length, row_length = g.row_length, diagonal = g.diagonal;
  const T *along = g.along.data(), *down = g.down.data(), *right = g.right.data(), *left = g.left.data();
  const T *along_near = g.along_near.data(), *down_near = g.down_near.data();
  const T *along_far = g.along_far.data(), *down_far = g.down_far.data(), *inverse_area = g.inverse_area.data();
  const T twist_along = p.twist_along, twist_down = p.twist_down, twist_diagonal = p.twist_diagonal;
  const T accelerate = p.accelerate, decay = p.decay, dt = p.dt, gravity_kick = p.gravity_kick;
  V3<T> previous = {};
  const bool narrow = s <= kBlock;
  if (!narrow)
    for (const auto* planes : {&edges.down, &edges.right, &edges.left})
      for (T* plane : *planes) std::fill_n(plane, edges.ring + kBlock, T(0));
  // What left `k` elements ago is at back(k), when `place` is where the present block is put.
  int place = narrow ? g.begin : 0;
  const auto back = [&](int k) { return place < k ? place - k + edges.ring : place - k; };
  const auto pass = [&](T* const(&planes)[3], const V3<T>& force) __attribute__((always_inline)) {
    put(planes, place, force);
    if (place < kBlock) put(planes, place + edges.ring, force);
  };

  // Of the edges at a vertex except those that arrive through memory, the sum of forces.
  const auto leave = [&](int i, const V3<T>& x, const V3<T>& v) __attribute__((always_inline)) {
    const V<T> none = {};
    const auto edge = [&](int j, const V<T>& k, T length, const V<T>& linear) __attribute__((always_inline)) {
      const V3<T> d = at(in.x, j) - x;
      const V<T> inverse = rsqrt(d.x * d.x + (d.y * d.y + (d.z * d.z + tiny<T>)));
      const V<T> ratio = length * inverse;
      V<T> pull = T(1) - ratio, rate = none + damping;
      if constexpr (kYields) {
        const V<T> shorter = pull < T(0) ? pull : none, limit = -buckling * ratio;
        rate = pull < T(0) ? none + shortened_damping : rate;
        pull += yields * shorter + buckled * (shorter > limit ? shorter : limit);
      }
      pull += (rate * dot(d, at(in.v, j) - v)) * (inverse * inverse);
      return (k * pull + linear) * d;
    };
    const V<T> a = load(along + i), b = load(down + i), r = load(right + i), l = load(left + i);
    const auto east = edge(i + 1, stretch * a, col_length, bend * load(along_near + i) + twist_along * a);
    const auto south = edge(i + s, stretch * b, row_length, bend * load(down_near + i) + twist_down * b);
    const auto south_east = edge(i + s + 1, shear * r, diagonal, twist_diagonal * r);
    const auto south_west = edge(i + s - 1, shear * l, diagonal, twist_diagonal * l);
    pass(edges.down, south);
    pass(edges.right, south_east);
    pass(edges.left, south_west);
    const V3<T> f = (east - V3<T>{late(previous.x, east.x), late(previous.y, east.y), late(previous.z, east.z)}) +
                    (south + (south_east + south_west));
    previous = east;
    return f;
  };
  // What arrives through memory, bending, air; then the substep itself.
  const auto move = [&](int i, const V3<T>& x, const V3<T>& v, V3<T> f) __attribute__((always_inline)) {
    f = f - (at(edges.down, back(s)) + (at(edges.right, back(s + 1)) + at(edges.left, back(s - 1))));
    const auto far = [&](int j, const T* weight)
                         __attribute__((always_inline)) { return load(weight) * (at(in.x, j) - x); };
    const V<T> b = V<T>{} + bend;
    f = f + b * ((far(i + 2, along_far + i) + far(i - 2, along_far + i - 2)) +
                 (far(i + 2 * s, down_far + i) + far(i - 2 * s, down_far + i - 2 * s)));
    if constexpr (kAir)
      f = f + ((at(air.corner[0], i) + at(air.corner[1], i - 1)) +
               (at(air.corner[2], i - s - 1) + at(air.corner[3], i - s)));
    const V<T> kick = accelerate * load(inverse_area + i);
    const V3<T> u = {decay * v.x + kick * f.x, decay * v.y + kick * f.y, decay * v.z + (kick * f.z - gravity_kick)};
    put(out.v, i, u);
    put(out.x, i, V3<T>{x.x + dt * u.x, x.y + dt * u.y, x.z + dt * u.z});
  };
  if (narrow) {
    for (int i = g.begin; i < g.end; i += kLanes<T>, place = i) put(edges.sum, i, leave(i, at(in.x, i), at(in.v, i)));
    place = g.begin;
    for (int i = g.begin; i < g.end; i += kLanes<T>, place = i) move(i, at(in.x, i), at(in.v, i), at(edges.sum, i));
  } else {
    for (int i = g.begin; i < g.end; i += kLanes<T>) {
      const V3<T> x = at(in.x, i), v = at(in.v, i);
      move(i, x, v, leave(i, x, v));
      place += kLanes<T>;
      if (place == edges.ring) place = 0;
    }
  }
}

template <class T>
const ExplicitLanes<T> table = {
    {{step<T, false, false>, step<T, false, true>}, {step<T, true, false>, step<T, true, true>}},
    {pressure<T>, air_and_pressure<T>},
    contact<T>,
};

}  // namespace
}  // namespace LANES

DEFINE_LANES(ExplicitLanes<float>, table<float>)
DEFINE_LANES(ExplicitLanes<double>, table<double>)

}  // namespace minicloth
