// The part of the Python module that the implicit solver uses.
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <string>

#include "implicit.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <int kDims>
using In = nb::ndarray<const double, nb::ndim<kDims>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// Flat arrays of 3 n numbers, axis by axis.
template <class A, class... Rest>
void need(int vertices, const A& first, const Rest&... rest) {
  if (first.shape(0) != std::size_t(3 * vertices)) throw std::invalid_argument("expected flat arrays (3 n,)");
  if constexpr (sizeof...(rest) > 0) need(vertices, rest...);
}

}  // namespace

void bind_implicit(nb::module_& m) {
  nb::class_<Potential>(m, "Potential")
      .def(nb::init<int, int, double, double, bool>(), nb::kw_only(), nb::arg("rows"), nb::arg("cols"),
           nb::arg("row_length"), nb::arg("col_length"), nb::arg("periodic"))
      .def(
          "begin",
          [](Potential& p, In<1> sheet, double tau, double inertia, In<1> base, In<1> along, Out target,
             double wind_normal, double wind_tangential, In<1> wind, double pressure) {
            need(p.vertices(), base, along, target);
            if (sheet.shape(0) != 6 || wind.shape(0) != 3)
              throw std::invalid_argument("sheet must be (6,), wind must be (3,)");
            const double *s = sheet.data(), *w = wind.data();
            p.begin({{s[0], s[1], s[2], s[3], s[4], s[5]},
                     tau,
                     inertia,
                     base.data(),
                     along.data(),
                     target.data(),
                     wind_normal,
                     wind_tangential,
                     {w[0], w[1], w[2]},
                     pressure});
          },
          nb::kw_only(), nb::arg("sheet"), nb::arg("tau"), nb::arg("inertia"), nb::arg("base"), nb::arg("along"),
          nb::arg("target"), nb::arg("wind_normal"), nb::arg("wind_tangential"), nb::arg("wind"), nb::arg("pressure"),
          "Freeze what a stage holds fixed; the pressure's push is added to target.")
      .def(
          "evaluate",
          [](Potential& p, In<1> x, Out gradient) {
            need(p.vertices(), x, gradient);
            return p.evaluate(x.data(), gradient.data());
          },
          "Energy [J]; writes its gradient [N].");

  nb::class_<Contact>(m, "Contact")
      .def(
          "__init__",
          [](Contact* self, int vertices, std::vector<int> handles, const std::vector<std::string>& kinds,
             const std::vector<double>& radii, const std::vector<double>& frictions, double thickness, double slack) {
            std::vector<Body> bodies;
            for (std::size_t i = 0; i < kinds.size(); ++i)
              bodies.push_back({kinds[i] == "plane", radii.at(i), frictions.at(i)});
            for (int h : handles)
              if (h < 0 || h >= vertices) throw std::invalid_argument("a handle is not a vertex of the grid");
            new (self) Contact(vertices, std::move(handles), std::move(bodies), thickness, slack);
          },
          nb::kw_only(), nb::arg("vertices"), nb::arg("handles"), nb::arg("kinds"), nb::arg("radii"),
          nb::arg("frictions"), nb::arg("thickness"), nb::arg("slack"))
      .def(
          "begin",
          [](Contact& c, In<1> start, In<1> base, In<3> bodies_start, In<3> bodies_base, In<3> bodies_end, double tau) {
            need(c.vertices(), start, base);
            for (const auto& b : {bodies_start, bodies_base, bodies_end})
              if (b.shape(0) != std::size_t(c.bodies()) || b.shape(1) != 2 || b.shape(2) != 3)
                throw std::invalid_argument("bodies must be (C, 2, 3)");
            c.begin(start.data(), base.data(), bodies_start.data(), bodies_base.data(), bodies_end.data(), tau);
          })
      .def("project",
           [](const Contact& c, In<1> from, Out x) {
             need(c.vertices(), from, x);
             c.project(from.data(), x.data());
           })
      .def("classify",
           [](Contact& c, In<1> x, In<1> g, In<1> mass, Out free_gradient) {
             need(c.vertices(), x, g, free_gradient);
             if (mass.shape(0) != std::size_t(c.vertices())) throw std::invalid_argument("mass must be (n,)");
             return c.classify(x.data(), g.data(), mass.data(), free_gradient.data());
           })
      .def("friction",
           [](const Contact& c, In<1> x, Out g) {
             need(c.vertices(), x, g);
             return c.friction(x.data(), g.data());
           })
      .def("confine",
           [](const Contact& c, In<1> x, Out d) {
             need(c.vertices(), x, d);
             c.confine(x.data(), d.data());
           })
      .def("finish", [](const Contact& c, In<1> x, In<1> g, In<1> free_gradient, Out v, Out reaction) {
        need(c.vertices(), x, g, free_gradient, v, reaction);
        c.finish(x.data(), g.data(), free_gradient.data(), v.data(), reaction.data());
      });
}

}  // namespace minicloth
