// The part of the Python module that the implicit solver uses.
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <string>

#include "arrays.hpp"
#include "implicit.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

using Flat = In<double, 1>;
using FlatOut = Out<double, 1>;
using Bodies = In<double, 3>;

// Flat arrays of 3 n numbers, axis by axis.
template <class A, class... Rest>
void need_flat(int vertices, const A& first, const Rest&... rest) {
  if (first.shape(0) != std::size_t(3 * vertices)) throw std::invalid_argument("expected flat arrays (3 n,)");
  if constexpr (sizeof...(rest) > 0) need_flat(vertices, rest...);
}

}  // namespace

void bind_implicit(nb::module_& m) {
  nb::class_<Potential>(m, "Potential")
      .def(nb::init<int, int, double, double, bool>(), nb::kw_only(), nb::arg("rows"), nb::arg("cols"),
           nb::arg("row_length"), nb::arg("col_length"), nb::arg("periodic"))
      .def(
          "begin",
          [](Potential& p, Flat sheet, double tau, double inertia, Flat base, Flat along, FlatOut target,
             double wind_normal, double wind_tangential, Flat wind, double pressure) {
            need_flat(p.vertices(), base, along, target);
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
          [](Potential& p, Flat x, FlatOut gradient) {
            need_flat(p.vertices(), x, gradient);
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
      .def("begin",
           [](Contact& c, Flat start, Flat base, Bodies bodies_start, Bodies bodies_base, Bodies bodies_end,
              double tau) {
             need_flat(c.vertices(), start, base);
             for (const auto& b : {bodies_start, bodies_base, bodies_end})
               if (b.shape(0) != std::size_t(c.bodies()) || b.shape(1) != 2 || b.shape(2) != 3)
                 throw std::invalid_argument("bodies must be (C, 2, 3)");
             c.begin(start.data(), base.data(), bodies_start.data(), bodies_base.data(), bodies_end.data(), tau);
           })
      .def("project",
           [](const Contact& c, Flat from, FlatOut x) {
             need_flat(c.vertices(), from, x);
             c.project(from.data(), x.data());
           })
      .def("classify",
           [](Contact& c, Flat x, Flat g, Flat mass, FlatOut free_gradient) {
             need_flat(c.vertices(), x, g, free_gradient);
             if (mass.shape(0) != std::size_t(c.vertices())) throw std::invalid_argument("mass must be (n,)");
             return c.classify(x.data(), g.data(), mass.data(), free_gradient.data());
           })
      .def("friction",
           [](const Contact& c, Flat x, FlatOut g) {
             need_flat(c.vertices(), x, g);
             return c.friction(x.data(), g.data());
           })
      .def("confine",
           [](const Contact& c, Flat x, FlatOut d) {
             need_flat(c.vertices(), x, d);
             c.confine(x.data(), d.data());
           })
      .def("finish", [](const Contact& c, Flat x, Flat g, Flat free_gradient, FlatOut v, FlatOut reaction) {
        need_flat(c.vertices(), x, g, free_gradient, v, reaction);
        c.finish(x.data(), g.data(), free_gradient.data(), v.data(), reaction.data());
      });
}

}  // namespace minicloth
