// Compiled once per instruction set; LANES names the namespace.
#include "lanes.hpp"

#include <algorithm>

#include "nearest.hpp"
#include "simd.hpp"

namespace minicloth {
namespace LANES {
namespace {

// One substep. Every edge is evaluated once, by f = k (1 - L/|d|) d + c (d.w)/|d|^2 d with c = damping * k (shortened
// ones may have less of the first and more of the second term) and the share of quadratic bending that lies on it, at
// the vertex that it leaves towards column + 1, row + 1 or a diagonal. It arrives one lane later (along) or about a row
// later, through memory; where rows are shorter than a vector, once all edges have left.
template <class T, bool kYields, bool kDamping, bool kBending, bool kAir>
void step(const Geometry<T>& g, const StepTerms<T>& p, const Planes<T>& in, const Planes<T>& out, const Cells<T>& air,
          const Edges<T>& edges) {
  const int s = g.stride;
  const T stretch = p.stretch, shear = p.shear, bend = p.bend, damping = p.damping;
  const T yields = p.yields, buckled = p.buckled, buckling = p.buckling, shortened_damping = p.shortened_damping;
  const T col_length = g.col_length, row_length = g.row_length, diagonal = g.diagonal;
  const T *along = g.along.data(), *down = g.down.data(), *right = g.right.data(), *left = g.left.data();
  const T *along_near = g.along_near.data(), *down_near = g.down_near.data();
  const T *along_far = g.along_far.data(), *down_far = g.down_far.data(), *inverse_area = g.inverse_area.data();
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
      if constexpr (kDamping) pull += (rate * dot(d, at(in.v, j) - v)) * (inverse * inverse);
      return (k * pull + linear) * d;
    };
    const auto east = edge(i + 1, stretch * load(along + i), col_length, kBending ? bend * load(along_near + i) : none);
    const auto south = edge(i + s, stretch * load(down + i), row_length, kBending ? bend * load(down_near + i) : none);
    const auto south_east = edge(i + s + 1, shear * load(right + i), diagonal, none);
    const auto south_west = edge(i + s - 1, shear * load(left + i), diagonal, none);
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
    if constexpr (kBending) {
      const auto far = [&](int j, const T* weight)
                           __attribute__((always_inline)) { return load(weight) * (at(in.x, j) - x); };
      const V<T> b = V<T>{} + bend;
      f = f + b * ((far(i + 2, along_far + i) + far(i - 2, along_far + i - 2)) +
                   (far(i + 2 * s, down_far + i) + far(i - 2 * s, down_far + i - 2 * s)));
    }
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

// Wind (Wejchert & Haumann 1991) and pressure on the four triangles of each cell that its two diagonals
// make, each with half its force: a mirrored cloth then feels mirrored air. Corners are numbered 0 upper
// left, 1 upper right, 2 lower right, 3 lower left; triangle k is the one without corner k.
template <class T, bool kWind>
void air(const Geometry<T>& g, const AirTerms<T>& p, const Planes<T>& in, const Cells<T>& out) {
  const int s = g.stride;
  const T* cell = g.cell.data();
  const V<T> zero = {};
  const V3<T> wind3 = {zero + 3 * p.wind[0], zero + 3 * p.wind[1], zero + 3 * p.wind[2]};
  const T normal = p.normal / 9, tangential = p.tangential / 9;  // for three times the velocity
  for (int i = g.begin; i < g.end; i += kLanes<T>) {
    const V3<T> x = at(in.x, i), right = at(in.x, i + 1) - x, across = at(in.x, i + s + 1) - x;
    const V3<T> down = at(in.x, i + s) - x;
    // Cross products of two sides, twice the triangles' area vectors.
    const V3<T> n1 = cross(down, across), n2 = cross(down, right), n3 = cross(across, right), n0 = (n1 + n3) - n2;
    const V<T> share = load(cell + i) / T(6);  // a third of half the force to each vertex
    V3<T> sum;                                 // three times a triangle's velocity is this less the missing corner's
    if constexpr (kWind) sum = (at(in.v, i) + at(in.v, i + 1)) + (at(in.v, i + s) + at(in.v, i + s + 1)) - wind3;
    const auto force = [&](const V3<T>& n, int missing) __attribute__((always_inline)) {
      V<T> along = zero + p.pressure / 2;
      if constexpr (kWind) {
        const V3<T> u = sum - at(in.v, missing);
        const V<T> square = dot(n, n) + T(1e-30), through = dot(n, u), turn = through * reciprocal(square);
        const V3<T> slide = u - turn * n;
        const V<T> product = square * dot(slide, slide) + T(1e-36);
        const V<T> drag = (tangential * product) * rsqrt(product);
        along -= (normal * (through < T(0) ? -through : through)) * turn;
        return along * n - drag * slide;
      } else {
        return along * n;
      }
    };
    const V3<T> f0 = force(n0, i), f1 = force(n1, i + 1), f2 = force(n2, i + s + 1), f3 = force(n3, i + s);
    const V3<T> all = (f0 + f2) + (f1 + f3);
    put(out.corner[0], i, share * (all - f0));
    put(out.corner[1], i, share * (all - f1));
    put(out.corner[2], i, share * (all - f2));
    put(out.corner[3], i, share * (all - f3));
  }
}

// Swept contact with Coulomb friction. In the body's frame a vertex goes from p0 to p1; where it would
// enter, the tangent plane at the entry point holds it, at the speed of the body. Friction takes up to
// mu times the normal change of velocity from the sliding speed.
enum Shape { kSphere, kCapsule, kPlane };
template <class T, Shape kShape>
void contact_with(const Geometry<T>& g, const BodyStep<T>& b, const Planes<T>& in, const Planes<T>& out) {
  const T radius = b.radius, radius2 = radius * radius, rate = T(1) / b.dt, dt = b.dt, friction = b.friction;
  const V<T> zero = {}, one = zero + T(1);
  const T slope[3] = {(b.after[0][0] - b.before[0][0]) * rate, (b.after[0][1] - b.before[0][1]) * rate,
                      (b.after[0][2] - b.before[0][2]) * rate};
  for (int i = g.begin; i < g.end; i += kLanes<T>) {
    const V3<T> x1 = at(out.x, i);
    V3<T> n, body = {zero + slope[0], zero + slope[1], zero + slope[2]};
    V<T> gap;
    auto touching = zero < zero;
    if constexpr (kShape == kPlane) {
      n = {zero + b.after[1][0], zero + b.after[1][1], zero + b.after[1][2]};
      const V3<T> point = {zero + b.after[0][0], zero + b.after[0][1], zero + b.after[0][2]};
      gap = dot(n, x1 - point) - radius;
      touching = gap < T(0);
      if (!any<T>(touching)) continue;
    } else {
      const V3<T> x0 = at(in.x, i);
      V<T> t1 = zero;
      V3<T> p0, p1;
      if constexpr (kShape == kSphere) {
        p0 = {x0.x - b.before[0][0], x0.y - b.before[0][1], x0.z - b.before[0][2]};
        p1 = {x1.x - b.after[0][0], x1.y - b.after[0][1], x1.z - b.after[0][2]};
      } else {
        t1 = nearest(b.after, x1);
        p0 = x0 - axis_point(b.before, nearest(b.before, x0)), p1 = x1 - axis_point(b.after, t1);
      }
      const V3<T> d = p1 - p0;
      const V<T> start2 = dot(p0, p0), outside = start2 - radius2, along = dot(p0, d);
      // Entering takes outside <= sqrt(disc) - along, of which neither is more than -along.
      if (!any<T>((outside < T(0)) | (outside <= T(-2.01) * along))) continue;
      const V<T> disc = along * along - dot(d, d) * outside;
      const auto inside = outside < T(0);
      const V<T> safe = disc > T(0) ? disc : zero;
      const V<T> time = outside / (safe * rsqrt(safe + T(1e-30)) - along + tiny<T>);
      const auto enters = (along < T(0)) & (disc > T(0)) & (time <= T(1)) & (outside >= T(0));
      const V<T> way = enters ? time : zero;
      const V<T> scale = inside ? rsqrt(start2 + tiny<T>) : one / radius;
      n = scale * (p0 + way * d);
      gap = dot(n, p1) - radius;
      touching = (inside | enters) & (gap < T(0));
      if (!any<T>(touching)) continue;
      if constexpr (kShape == kCapsule) {
        const V<T> r = zero + rate;
        body = r * (axis_point(b.after, t1) - axis_point(b.before, t1));
      }
    }
    const V3<T> v = at(out.v, i), u = v - body;
    const V<T> un = dot(u, n);
    const V<T> stop = (touching & (un < T(0))) ? -un : zero;  // normal change of velocity
    const V3<T> slide = u - un * n;
    const V<T> held = friction * stop * rsqrt(dot(slide, slide) + tiny<T>);
    const V<T> hold = held < T(1) ? held : one;
    const V<T> push = touching ? -gap : zero, back = dt * hold;
    put(out.v, i, v + (stop * n - hold * slide));
    put(out.x, i, x1 + (push * n - back * slide));
  }
}

template <class T>
void contact(const Geometry<T>& g, const BodyStep<T>& b, const Planes<T>& in, const Planes<T>& out) {
  const auto point = [](const T(&ends)[2][3]) {
    return ends[0][0] == ends[1][0] && ends[0][1] == ends[1][1] && ends[0][2] == ends[1][2];
  };
  if (b.plane) return contact_with<T, kPlane>(g, b, in, out);
  if (point(b.before) && point(b.after)) return contact_with<T, kSphere>(g, b, in, out);
  contact_with<T, kCapsule>(g, b, in, out);
}

// Whether a state is sound. Unpadded arrays (3, rows, cols).
template <class T>
Check check(const T* x, const T* v, int rows, int cols, T row_length, T col_length, bool periodic) {
  const int n = rows * cols;
  const V<T> zero = {};
  V<T> bad = zero, square = zero;
  T bad1 = 0, square1 = 0;
  int i = 0;
  for (; i + kLanes<T> <= 3 * n; i += kLanes<T>) {
    bad += load(x + i) * T(0);  // NaN unless finite
    square += load(v + i) * load(v + i);
  }
  for (; i < 3 * n; ++i) bad1 += x[i] * T(0), square1 += v[i] * v[i];
  const auto longest = [&](int from, int step, int count, T scale) {
    V<T> most = zero;
    T most1 = 0;
    int k = from;
    for (; k + kLanes<T> <= from + count; k += kLanes<T>) {
      const V<T> a = load(x + k + step) - load(x + k), b = load(x + k + step + n) - load(x + k + n);
      const V<T> c = load(x + k + step + 2 * n) - load(x + k + 2 * n), d = a * a + b * b + c * c;
      most = most > d ? most : d;
    }
    for (; k < from + count; ++k) {
      const T a = x[k + step] - x[k], b = x[k + step + n] - x[k + n], c = x[k + step + 2 * n] - x[k + 2 * n];
      const T d = a * a + b * b + c * c;
      most1 = most1 > d ? most1 : d;
    }
    for (int l = 0; l < kLanes<T>; ++l) most1 = most1 > most[l] ? most1 : most[l];
    return double(most1) * double(scale);
  };
  const T along = 1 / (col_length * col_length), down = 1 / (row_length * row_length);
  double stretch = longest(0, cols, n - cols, down);
  for (int r = 0; r < rows; ++r) {
    stretch = std::fmax(stretch, longest(r * cols, 1, cols - 1, along));
    if (periodic) stretch = std::fmax(stretch, longest(r * cols + cols - 1, 1 - cols, 1, along));
  }
  for (int l = 0; l < kLanes<T>; ++l) bad1 += bad[l], square1 += square[l];
  return {std::isfinite(bad1) && std::isfinite(square1), std::sqrt(stretch) - 1, 0.5 * double(square1) / n};
}

template <class T>
const Lanes<T> table = {
    {{{step<T, false, false, false, false>, step<T, false, false, false, true>},
      {step<T, false, false, true, false>, step<T, false, false, true, true>}},
     {{step<T, false, true, false, false>, step<T, false, true, false, true>},
      {step<T, false, true, true, false>, step<T, false, true, true, true>}}},
    {step<T, true, true, true, false>, step<T, true, true, true, true>},
    {air<T, false>, air<T, true>},
    contact<T>,
    check<T>,
};

}  // namespace

const Lanes<float>& lanes(float) { return table<float>; }
const Lanes<double>& lanes(double) { return table<double>; }

}  // namespace LANES
}  // namespace minicloth
