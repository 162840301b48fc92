// P-ADMM for Python.
#include "../sheet/bind.hpp"

#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/vector.h>

#include "../module.hpp"
#include "core.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <class T>
void advance_admm(const Admm<T>& solver, const PythonState& old, const PythonState& now, const PythonControls& controls,
                  const typename Admm<T>::Systems& systems, int threads) {
  const Frames<T> frames(solver.sheet(), old, now, controls);
  need(systems.size() == frames().size(), "systems must be B");
  need(threads >= 1, "threads must be at least 1");
  nb::gil_scoped_release release;
  solver.advance(frames(), systems, threads);
}

template <class T>
void make_admm(Admm<T>* self, const Sheet& sheet, int substeps, int iterations, double weight, In<double, 2> row_basis,
               In<double, 2> col_basis) {
  const std::size_t rows = sheet.rows, cols = sheet.cols;
  need(shaped(row_basis, {rows, rows}) && shaped(col_basis, {cols, cols}), "bases must be (H, H) and (W, W)");
  need(substeps >= 1 && iterations >= 1, "substeps and iterations must be at least 1");
  new (self) Admm<T>(sheet, substeps, iterations, weight, row_basis.data(), col_basis.data());
}

template <class T>
std::shared_ptr<System<T>> make_system(const Admm<T>& solver, const Material& material, In<double, 2> eigenvalues,
                                       In<double, 3> capacitance) {
  const Sheet& s = solver.sheet();
  const std::size_t held = s.handles.size();
  need(shaped(eigenvalues, {std::size_t(s.rows), std::size_t(s.cols)}) && shaped(capacitance, {3, held, held}),
       "eigenvalues must be (H, W), the capacitance (3, N, N)");
  return std::make_shared<System<T>>(solver.system(material, eigenvalues.data(), capacitance.data()));
}

template <class T>
void solve_admm(const Admm<T>& solver, const System<T>& system, In<T, 3> right, Out<T, 3> x) {
  const std::initializer_list<std::size_t> cloth = {3, std::size_t(solver.sheet().rows),
                                                    std::size_t(solver.sheet().cols)};
  need(shaped(right, cloth) && shaped(x, cloth), "right-hand side and solution must be (3, H, W)");
  solver.solve(system, right.data(), x.data());
}

template <class T>
void bind_admm(nb::module_& m, const char* name, const char* system) {
  nb::class_<System<T>>(m, system);
  nb::class_<Admm<T>>(m, name)
      .def("__init__", &make_admm<T>, nb::arg("sheet"), nb::kw_only(), nb::arg("substeps"), nb::arg("iterations"),
           nb::arg("weight"), nb::arg("row_basis"), nb::arg("col_basis"))
      .def("system", &make_system<T>, nb::arg("material"), nb::arg("eigenvalues"), nb::arg("capacitance"),
           "A material with the matrix of its steps.")
      .def("solve", &solve_admm<T>, nb::arg("system"), nb::arg("right"), nb::arg("x"), "One global step alone.")
      .def("advance", &advance_admm<T>, nb::arg("old"), nb::arg("new"), nb::arg("controls"), nb::arg("systems"),
           nb::arg("threads"), "A frame from old to the positions and velocities of new; systems of each cloth.");
}

}  // namespace

void bind_admm(nb::module_& m) {
  bind_admm<float>(m, "Admm32", "AdmmSystem32");
  bind_admm<double>(m, "Admm64", "AdmmSystem64");
}

}  // namespace minicloth
