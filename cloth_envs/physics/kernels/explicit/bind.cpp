// The explicit solver for Python.
#include "../sheet/bind.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>

#include "../module.hpp"
#include "../sheet/drives.hpp"
#include "core.hpp"
#include "tracking.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <class T>
std::vector<double> speeds_of(const Explicit<T>& solver, const Frames<T>& frames) {
  std::vector<double> speeds;
  for (const Frame<T>& frame : frames()) speeds.push_back(fastest(solver.sheet(), frame));
  return speeds;
}

template <class T>
std::vector<double> advance_explicit(const Explicit<T>& solver, const PythonState& old, const PythonState& now,
                                     const PythonControls& controls, const std::vector<Material>& materials,
                                     In<int, 3> substeps, const std::vector<double>& fast, Out<int, 1> levels,
                                     Out<int, 1> crossings, double most, int threads, const Tracking* tracking) {
  const Frames<T> frames(solver.sheet(), old, now, controls);
  const std::size_t batch = frames().size(), count = solver.levels();
  need(materials.size() == batch && fast.size() == batch && shaped(substeps, {batch, count, 2}) &&
           shaped(levels, {batch}) && shaped(crossings, {batch}),
       "materials, fast, levels and crossings must be B, substeps (B, L, 2)");
  std::vector<Cuts> cuts(batch);
  for (std::size_t b = 0; b < batch; ++b) {
    cuts[b].fast = fast[b];
    for (std::size_t l = 0; l < count; ++l) {
      need(substeps(b, l, 0) >= 1 && substeps(b, l, 1) >= 1, "substeps must be at least 1");
      cuts[b].levels.push_back({substeps(b, l, 0), substeps(b, l, 1)});
    }
  }
  need(threads >= 1, "threads must be at least 1");
  if (tracking) {
    const std::size_t rows = tracking->down.left.size(), cols = tracking->across.left.size();
    need(int(rows) == solver.sheet().rows && int(cols) == solver.sheet().cols &&
             tracking->paths.size() == batch * 3 * tracking->down.coarse * tracking->across.coarse,
         "tracking must be of the sheet's rows and columns, and aimed at B cloths");
  }
  if (std::isfinite(most)) {
    const std::vector<double> speeds = speeds_of(solver, frames);
    if (*std::max_element(speeds.begin(), speeds.end()) > most) return speeds;
  }
  nb::gil_scoped_release release;
  solver.advance(frames(), materials, cuts, tracking, threads, levels.data(), crossings.data());
  return {};
}

template <class T>
std::vector<double> speeds_explicit(const Explicit<T>& solver, const PythonState& old, const PythonState& now,
                                    const PythonControls& controls) {
  return speeds_of(solver, Frames<T>(solver.sheet(), old, now, controls));
}

// What `of` finds in each cloth of a batch of fields (B, 3, H, W).
template <class T, class Of>
auto of_each(const Explicit<T>& solver, const In<T, 4>& fields, const Of& of) {
  const std::size_t batch = fields.shape(0), rows = solver.sheet().rows, cols = solver.sheet().cols;
  need(shaped(fields, {batch, 3, rows, cols}), "positions and velocities must be (B, 3, H, W)");
  std::vector<decltype(of(0, fields.data()))> found;
  for (std::size_t b = 0; b < batch; ++b) found.push_back(of(b, fields.data() + b * 3 * rows * cols));
  return found;
}

template <class T>
std::vector<double> shear_explicit(const Explicit<T>& solver, In<T, 4> positions) {
  return of_each(solver, positions, [&](std::size_t, const T* x) { return solver.shear(x); });
}

template <class T>
std::vector<double> apart_explicit(const Explicit<T>& solver, In<T, 4> velocities) {
  return of_each(solver, velocities, [&](std::size_t, const T* v) { return solver.apart(v); });
}

template <class T>
std::vector<int> levels_explicit(const Explicit<T>& solver, In<T, 4> positions, In<T, 4> velocities,
                                 const std::vector<double>& fast) {
  const std::vector<const T*> v = of_each(solver, velocities, [](std::size_t, const T* at) { return at; });
  need(v.size() == positions.shape(0) && fast.size() == v.size(), "velocities and fast must be B");
  return of_each(solver, positions, [&](std::size_t b, const T* x) { return solver.level(x, v[b], fast[b]); });
}

template <class T>
void bind_explicit(nb::module_& m, const char* name) {
  nb::class_<Explicit<T>>(m, name)
      .def(nb::init<Sheet, std::vector<double>>(), nb::arg("sheet"), nb::arg("sheared"))
      .def(
          "advance", &advance_explicit<T>, nb::arg("old"), nb::arg("new"), nb::arg("controls"), nb::arg("materials"),
          nb::arg("substeps"), nb::arg("fast"), nb::arg("levels"), nb::arg("crossings"), nb::arg("most"),
          nb::arg("threads"), nb::arg("tracking").none() = nb::none(),
          "A frame from old to the positions and velocities of new, of each cloth's material. substeps (B, L, 2): "
          "their number, and for how many of them bending and the air are held, of each of the L levels; levels (B,) "
          "says which were taken, crossings (B,) how many pairs of triangles crossed in old, with contact of the cloth "
          "with itself. Where something is faster than most [m/s], nothing is done but to return the speeds. tracking "
          "pulls the cloths along.")
      .def("shear", &shear_explicit<T>, nb::arg("positions"),
           "The largest shear of each cloth, (B,), of positions (B, 3, H, W): the mean sine at an inner vertex's four "
           "corners, as long as edges have their lengths; those above may count against those below, those to the left "
           "against those to the right.")
      .def("apart", &apart_explicit<T>, nb::arg("velocities"),
           "The largest speed of a vertex over its neighbour's along a row or column in each cloth, (B,) [m/s].")
      .def("levels", &levels_explicit<T>, nb::arg("positions"), nb::arg("velocities"), nb::arg("fast"),
           "Which cuts hold, (B,): the first whose sine of `sheared` the shear does not exceed, the last where "
           "neighbours part at over `fast` (B,) [m/s].")
      .def("speeds", &speeds_explicit<T>, nb::arg("old"), nb::arg("new"), nb::arg("controls"),
           "The largest speed of cloth, handles or bodies in each cloth's frame [m/s].");
}

Linear linear(const In<double, 2>& weights) {
  return Linear(weights.data(), int(weights.shape(0)), int(weights.shape(1)));
}

void aim(Tracking& tracking, In<double, 4> x0, In<double, 4> v0, In<double, 4> x1, In<double, 4> v1, double dt) {
  const std::size_t rows = tracking.down.coarse, cols = tracking.across.coarse, batch = x0.shape(0);
  for (const auto* one : {&x0, &v0, &x1, &v1})
    need(shaped(*one, {batch, 3, rows, cols}), "where the cloths go must be (B, 3, h, w)");
  tracking.paths.clear();
  for (std::size_t i = 0; i < batch * 3 * rows * cols; ++i)
    tracking.paths.push_back({x0.data()[i], dt * v0.data()[i], x1.data()[i], dt * v1.data()[i]});
}

void bind_tracking(nb::module_& m) {
  nb::class_<Tracking>(m, "Tracking", "What pulls the cloths of a batch along with coarser ones of h x w vertices.")
      .def(
          "__init__",
          [](Tracking* self, In<double, 2> down, In<double, 2> across, bool means, double rate, double damping,
             double levels) {
            const Linear rows = linear(down), cols = linear(across);
            need(rows.coarse >= 3 && cols.coarse >= 3, "a coarse sheet has three rows and columns at least");
            need(rate > 0 && damping >= 0 && levels >= 0, "rate must be positive, damping and levels not negative");
            for (const Linear* side : {&rows, &cols})
              for (int at = 0; !means && at < side->coarse; ++at)
                need(side->shared(at) >= 0, "each coarse vertex must be one of the fine ones");
            new (self) Tracking{rows, cols, means, rate, damping, levels, {}};
          },
          nb::kw_only(), nb::arg("down"), nb::arg("across"), nb::arg("means"), nb::arg("rate"), nb::arg("damping"),
          nb::arg("levels"),
          "down (H, h) and across (W, w) interpolate linearly between coarse rows and columns. Of means those of the "
          "fine cloth around coarse vertices are pulled, else the vertices that both share, by springs of rate [1/s] "
          "and damping over the critical one, with levels times the coarse sheet's own forces.")
      .def("aim", &aim, nb::arg("x0"), nb::arg("v0"), nb::arg("x1"), nb::arg("v1"), nb::arg("dt"),
           "Where what is pulled is to be at the start and end of the next frame of dt [s], and how fast, (B, 3, h, w) "
           "each: cubics.");
}

}  // namespace

void bind_explicit(nb::module_& m) {
  bind_tracking(m);
  bind_explicit<float>(m, "Explicit32");
  bind_explicit<double>(m, "Explicit64");
}

}  // namespace minicloth
