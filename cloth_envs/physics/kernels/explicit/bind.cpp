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
                                     In<int, 2> substeps, double most, int threads) {
  const Frames<T> frames(solver.sheet(), old, now, controls);
  const std::size_t batch = frames().size();
  need(materials.size() == batch && shaped(substeps, {batch, 2}), "materials must be B, substeps (B, 2)");
  std::vector<Substeps> cuts;
  for (std::size_t b = 0; b < batch; ++b) {
    const int* const cut = substeps.data() + 2 * b;
    need(cut[0] >= 1 && cut[1] >= 1, "substeps must be at least 1");
    cuts.push_back({cut[0], cut[1]});
  }
  need(threads >= 1, "threads must be at least 1");
  if (std::isfinite(most)) {
    const std::vector<double> speeds = speeds_of(solver, frames);
    if (*std::max_element(speeds.begin(), speeds.end()) > most) return speeds;
  }
  nb::gil_scoped_release release;
  solver.advance(frames(), materials, cuts, threads);
  return {};
}

template <class T>
std::vector<double> speeds_explicit(const Explicit<T>& solver, const PythonState& old, const PythonState& now,
                                    const PythonControls& controls) {
  return speeds_of(solver, Frames<T>(solver.sheet(), old, now, controls));
}

template <class T>
void bind_explicit(nb::module_& m, const char* name) {
  nb::class_<Explicit<T>>(m, name)
      .def(nb::init<Sheet>(), nb::arg("sheet"))
      .def("advance", &advance_explicit<T>, nb::arg("old"), nb::arg("new"), nb::arg("controls"), nb::arg("materials"),
           nb::arg("substeps"), nb::arg("most"), nb::arg("threads"),
           "A frame from old to the positions and velocities of new, of each cloth's material. substeps (B, 2): their "
           "number, and for how many of them bending and the air are held. Where something is faster than most [m/s], "
           "nothing is done but to return the speeds.")
      .def("speeds", &speeds_explicit<T>, nb::arg("old"), nb::arg("new"), nb::arg("controls"),
           "The largest speed of cloth, handles or bodies in each cloth's frame [m/s].");
}

}  // namespace

void bind_explicit(nb::module_& m) {
  bind_explicit<float>(m, "Explicit32");
  bind_explicit<double>(m, "Explicit64");
}

}  // namespace minicloth
