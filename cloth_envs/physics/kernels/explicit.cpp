#include "explicit.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "frames.hpp"

namespace minicloth {
namespace {

// Two states (the step reads one and writes the other), the forces of the air and of the edges.
template <class T>
struct Workspace {
  Plane<T> memory;
  Planes<T> now, next;
  Cells<T> air;
  Edges<T> edges;
  int stride = 0, rows = 0, begin = 0;

  // Ghosts must hold 0, in the edges always and in the state at the start of a frame.
  void prepare(const Geometry<T>& g) {
    if (stride == g.stride && rows == g.rows && begin == g.begin) {
      for (int k = 0; k < 3; ++k) std::fill_n(now.x[k], g.size, T(0)), std::fill_n(now.v[k], g.size, T(0));
      return;
    }
    stride = g.stride, rows = g.rows, begin = g.begin;
    // Edges wait for about a row; in narrow grids all of them do.
    edges.ring = g.stride <= kBlock ? int(g.size) : (g.stride + 2 * kBlock) / kBlock * kBlock;
    const std::size_t waiting = std::size_t(edges.ring) + kBlock;
    memory.assign(27 * g.size + 9 * waiting, T(0));
    T* p = memory.data();
    const auto take = [&](auto& planes, std::size_t size) {
      for (T*& plane : planes) plane = std::exchange(p, p + size);
    };
    for (auto* s : {&now, &next}) take(s->x, g.size), take(s->v, g.size);
    for (auto& corner : air.corner) take(corner, g.size);
    take(edges.sum, g.size);
    for (auto* e : {&edges.down, &edges.right, &edges.left}) take(*e, waiting);
  }
};

template <class T>
void wrap(const Geometry<T>& g, const Planes<T>& s) {
  for (T* plane : {s.x[0], s.x[1], s.x[2], s.v[0], s.v[1], s.v[2]})
    for (int r = 0; r < g.rows; ++r) {
      T* row = plane + g.at(r, 0);
      for (int k = 1; k <= kGhost; ++k) row[-k] = row[g.cols - k], row[g.cols + k - 1] = row[k - 1];
    }
}

}  // namespace

template <class T>
void Explicit<T>::advance(const Frame<T>& f) const {
  const Geometry<T>& g = geometry_;
  const World& w = world_;
  const Lanes<T>& lanes = best_lanes<T>();
  thread_local Workspace<T> work;
  work.prepare(g);
  Planes<T> now = work.now, next = work.next;

  const int n = g.rows * g.cols;
  const auto each_row = [&](const Planes<T>& s, auto copy) {
    for (int k = 0; k < 6; ++k)
      for (int r = 0; r < g.rows; ++r) copy((k < 3 ? s.x[k] : s.v[k - 3]) + g.at(r, 0), k, r * g.cols);
  };
  each_row(now, [&](T* row, int k, int i) { std::copy_n((k < 3 ? f.x + k * n : f.v + (k - 3) * n) + i, g.cols, row); });
  if (g.periodic) wrap(g, now);

  const double dt = w.frame_dt / f.substeps, frame_dt = w.frame_dt;
  // Drag is integrated exactly: dv/dt = a - drag v over a substep with a constant.
  const double decay = std::exp(-f.sheet.drag * dt);
  const double lag = f.sheet.drag > 0 ? -std::expm1(-f.sheet.drag * dt) / f.sheet.drag : dt;
  // A spring shortened by e has the tension -k c (min(e, b) + q max(e - b, 0)), b the length at which it buckles. On
  // top of a linear spring's -k e that is k (1 - c q) e and -k c (1 - q) min(e, b).
  const double c = f.sheet.compression, q = f.sheet.post_buckling;
  const StepTerms<T> terms{T(f.sheet.stretch),
                           T(f.sheet.shear),
                           T(f.sheet.bend),
                           T(f.sheet.damping),
                           T(c * q - 1),
                           T(c - c * q),
                           T(f.sheet.buckling_strain),
                           T(f.sheet.compression_damping * f.sheet.damping),
                           T(lag / f.sheet.density),
                           T(decay),
                           T(dt),
                           T(lag * w.gravity)};
  const AirTerms<T> blow{T(w.wind_normal / 4),
                         T(w.wind_tangential / 4),
                         T(w.pressure ? f.pressure : 0.0),
                         {T(f.wind[0]), T(f.wind[1]), T(f.wind[2])}};
  const bool air = w.wind || w.pressure;
  const auto step =
      f.sheet.yields() ? lanes.yielding_step[air] : lanes.step[f.sheet.damping > 0][f.sheet.bend > 0][air];

  std::vector<Driven> handles(w.handles.size());
  std::vector<Cubic> bodies(6 * w.bodies.size());
  for (std::size_t h = 0; h < handles.size(); ++h) {
    const int vertex = w.handles[h];
    handles[h] = {g.at(vertex / g.cols, vertex % g.cols), false, {}};
    for (int k = 0; k < 3; ++k) {
      const int i = k * n + vertex;
      const Cubic path = {f.x[i], f.v[i] * frame_dt, f.handle_x[3 * h + k], f.handle_v[3 * h + k] * frame_dt};
      handles[h].path[k] = path;
      handles[h].moves |= path.p0 != path.p1 || path.v0 != 0 || path.v1 != 0;
    }
  }
  for (std::size_t i = 0; i < bodies.size(); ++i)
    bodies[i] = {f.body_x[i], f.body_v[i] * frame_dt, f.body_x_end[i], f.body_v_end[i] * frame_dt};

  std::vector<BodyStep<T>> moves(w.bodies.size());
  const auto move_bodies = [&](double s) {
    for (std::size_t i = 0; i < bodies.size(); ++i) {
      BodyStep<T>& body = moves[i / 6];
      T &before = body.before[i / 3 % 2][i % 3], &after = body.after[i / 3 % 2][i % 3];
      before = after, after = T(bodies[i].position(s));
    }
  };
  for (std::size_t b = 0; b < moves.size(); ++b) {
    moves[b].plane = w.bodies[b].plane, moves[b].friction = T(w.bodies[b].friction);
    moves[b].radius = T(w.bodies[b].radius + w.thickness), moves[b].dt = T(dt);
  }
  move_bodies(0.0);

  for (int k = 0; k < f.substeps; ++k) {
    const double s1 = double(k + 1) / f.substeps;
    if (air) lanes.air[w.wind](g, blow, now, work.air);
    step(g, terms, now, next, work.air, work.edges);
    move_bodies(s1);
    for (const BodyStep<T>& body : moves) lanes.contact(g, body, now, next);
    for (const Driven& h : handles)
      for (int c = 0; c < 3; ++c) {
        const Cubic& path = h.path[c];
        next.x[c][h.index] = T(h.moves ? path.position(s1) : path.p0);
        next.v[c][h.index] = T(h.moves ? path.velocity(s1) / frame_dt : 0.0);
      }
    if (g.periodic) wrap(g, next);
    std::swap(now, next);
  }
  each_row(now, [&](T* row, int k, int i) {
    std::copy_n(row, g.cols, (k < 3 ? f.x_out + k * n : f.v_out + (k - 3) * n) + i);
  });
}

template <class T>
void Explicit<T>::advance(const std::vector<Frame<T>>& frames, int threads) const {
  for_each_member(frames.size(), threads, [&](std::size_t i) { advance(frames[i]); });
}

template class Explicit<float>;
template class Explicit<double>;

}  // namespace minicloth
