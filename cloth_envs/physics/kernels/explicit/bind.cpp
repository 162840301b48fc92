// The explicit solver for Python.
#include "../sheet/bind.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>

#include "../module.hpp"
#include "../sheet/drives.hpp"
#include "core.hpp"

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
                                     In<int, 3> substeps, Out<int, 1> levels, Out<int, 1> crossings, double most,
                                     int threads) {
  const Frames<T> frames(solver.sheet(), old, now, controls);
  const std::size_t batch = frames().size(), count = solver.levels();
  need(materials.size() == batch && shaped(substeps, {batch, count, 2}) && shaped(levels, {batch}) &&
           shaped(crossings, {batch}),
       "materials, levels and crossings must be B, substeps (B, L, 2)");
  std::vector<Cuts> cuts(batch, Cuts(count));
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t l = 0; l < count; ++l) {
      cuts[b][l] = {substeps(b, l, 0), substeps(b, l, 1)};
      need(cuts[b][l].count >= 1 && cuts[b][l].held >= 1, "substeps must be at least 1");
    }
  need(threads >= 1, "threads must be at least 1");
  if (std::isfinite(most)) {
    const std::vector<double> speeds = speeds_of(solver, frames);
    if (*std::max_element(speeds.begin(), speeds.end()) > most) return speeds;
  }
  nb::gil_scoped_release release;
  solver.advance(frames(), materials, cuts, threads, levels.data(), crossings.data());
  return {};
}

template <class T>
std::vector<double> speeds_explicit(const Explicit<T>& solver, const PythonState& old, const PythonState& now,
                                    const PythonControls& controls) {
  return speeds_of(solver, Frames<T>(solver.sheet(), old, now, controls));
}

template <class T>
std::vector<double> shear_explicit(const Explicit<T>& solver, In<T, 4> positions) {
  const std::size_t batch = positions.shape(0), rows = solver.sheet().rows, cols = solver.sheet().cols;
  need(shaped(positions, {batch, 3, rows, cols}), "positions must be (B, 3, H, W)");
  std::vector<double> found;
  for (std::size_t b = 0; b < batch; ++b) found.push_back(solver.shear(positions.data() + b * 3 * rows * cols));
  return found;
}

template <class T>
void bind_explicit(nb::module_& m, const char* name) {
  nb::class_<Explicit<T>>(m, name)
      .def(nb::init<Sheet, std::vector<double>>(), nb::arg("sheet"), nb::arg("sheared"))
      .def("advance", &advance_explicit<T>, nb::arg("old"), nb::arg("new"), nb::arg("controls"), nb::arg("materials"),
           nb::arg("substeps"), nb::arg("levels"), nb::arg("crossings"), nb::arg("most"), nb::arg("threads"),
           "A frame from old to the positions and velocities of new, of each cloth's material. substeps (B, L, 2): "
           "their number, and for how many of them bending and the air are held, while shear has at most each of the L "
           "sines `sheared`; levels (B,) says which were taken, crossings (B,) how many pairs of triangles crossed in "
           "old, "
           "with contact of the cloth with itself. Where something is faster than most [m/s], nothing is "
           "done but to return the speeds.")
      .def("shear", &shear_explicit<T>, nb::arg("positions"),
           "The largest shear of each cloth, (B,), of positions (B, 3, H, W): the mean sine at an inner vertex's four "
           "corners, as long as edges have their lengths.")
      .def("speeds", &speeds_explicit<T>, nb::arg("old"), nb::arg("new"), nb::arg("controls"),
           "The largest speed of cloth, handles or bodies in each cloth's frame [m/s].");
}

}  // namespace

void bind_explicit(nb::module_& m) {
  bind_explicit<float>(m, "Explicit32");
  bind_explicit<double>(m, "Explicit64");
}

}  // namespace minicloth
