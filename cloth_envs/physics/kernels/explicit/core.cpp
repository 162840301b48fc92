#include "core.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "../base/threads.hpp"
#include "../sheet/drives.hpp"

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
StepTerms<T> terms_of(const Material& m, double gravity, double dt) {
  // Drag is integrated exactly: dv/dt = a - drag v over a substep with a constant.
  const double decay = std::exp(-m.drag * dt);
  const double lag = m.drag > 0 ? -std::expm1(-m.drag * dt) / m.drag : dt;
  // A spring shortened by e has the tension -k c (min(e, b) + q max(e - b, 0)), b the length at which it buckles. On
  // top of a linear spring's -k e that is k (1 - c q) e and -k c (1 - q) min(e, b).
  const double c = m.compression, q = m.post_buckling;
  return {T(m.stretch_stiffness),
          T(m.shear_stiffness),
          T(m.bend_stiffness),
          T(m.damping),
          T(c * q - 1),
          T(c - c * q),
          T(m.buckling_strain),
          T(m.compression_damping * m.damping),
          T(lag / m.areal_density),
          T(decay),
          T(dt),
          T(lag * gravity)};
}

}  // namespace

template <class T>
Explicit<T>::Explicit(Sheet sheet)
    : sheet_(std::move(sheet)),
      geometry_(sheet_.rows, sheet_.cols, sheet_.row_length, sheet_.col_length, sheet_.periodic, true) {}

template <class T>
void Explicit<T>::advance(const Frame<T>& f, const Material& material, int substeps) const {
  const Geometry<T>& g = geometry_;
  const auto& kernels = lanes<ExplicitLanes<T>>();
  thread_local Workspace<T> work;
  work.prepare(g);
  Planes<T> now = work.now, next = work.next;
  g.pad(f.x, now.x), g.pad(f.v, now.v);
  g.wrap(now.x), g.wrap(now.v);

  const double dt = sheet_.frame_dt / substeps;
  const StepTerms<T> terms = terms_of<T>(material, sheet_.gravity, dt);
  const AirTerms<T> blow = air_terms(sheet_, f);
  const bool air = sheet_.wind || sheet_.pressure;
  const auto step = kernels.step[material.yields()][air];
  const double stiffness = material.stretch_stiffness / material.areal_density;
  const auto handles = handles_of(sheet_, f, stiffness, [&](int vertex) { return g.at(vertex); });
  MovingBodies<T> bodies(sheet_, f, dt);

  for (int k = 0; k < substeps; ++k) {
    const double end = double(k + 1) / substeps;
    if (air) kernels.air[sheet_.wind](g, blow, now, work.air);
    step(g, terms, now, next, work.air, work.edges);
    for (const BodyStep<T>& body : bodies.to(end)) kernels.contact(g, body, now, next);
    hold(handles, end, dt, next.x, next.v);
    g.wrap(next.x), g.wrap(next.v);
    std::swap(now, next);
  }
  g.unpad(now.x, f.x_out), g.unpad(now.v, f.v_out);
}

template <class T>
void Explicit<T>::advance(const std::vector<Frame<T>>& frames, const std::vector<Material>& materials,
                          const int* substeps, int threads) const {
  for_each_member(frames.size(), threads, [&](std::size_t i) { advance(frames[i], materials[i], substeps[i]); });
}

template class Explicit<float>;
template class Explicit<double>;

}  // namespace minicloth
