// The implicit solver for Python.
#include "../base/arrays.hpp"
#include "../module.hpp"
#include "contact.hpp"
#include "core.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

using Flat = In<double, 1>;
using FlatOut = Out<double, 1>;
using Ends = In<double, 3>;

// Flat arrays of 3 n numbers, axis by axis.
template <class A, class... Rest>
void need_flat(int vertices, const A& first, const Rest&... rest) {
  need(shaped(first, {std::size_t(3 * vertices)}), "expected flat arrays (3 n,)");
  if constexpr (sizeof...(rest) > 0) need_flat(vertices, rest...);
}

}  // namespace

void bind_implicit(nb::module_& m) {
  nb::class_<Potential>(m, "Potential")
      .def(nb::init<Sheet>(), nb::arg("sheet"))
      .def(
          "begin",
          [](Potential& p, const Material& material, double tau, double inertia, Flat base, Flat along, FlatOut target,
             Flat velocity, Flat wind, double pressure) {
            need_flat(p.vertices(), base, along, target, velocity);
            need(shaped(wind, {3}), "wind must be (3,)");
            const double* w = wind.data();
            p.begin({material,
                     tau,
                     inertia,
                     base.data(),
                     along.data(),
                     target.data(),
                     velocity.data(),
                     {w[0], w[1], w[2]},
                     pressure});
          },
          nb::kw_only(), nb::arg("material"), nb::arg("tau"), nb::arg("inertia"), nb::arg("base"), nb::arg("along"),
          nb::arg("target"), nb::arg("velocity"), nb::arg("wind"), nb::arg("pressure"),
          "Freeze what a stage holds fixed; the pressure's push is added to target.")
      .def(
          "draw",
          [](Potential& p, In<int, 1> which, In<double, 1> stiffness, In<double, 1> places) {
            const std::size_t count = which.shape(0);
            need(shaped(stiffness, {count}) && shaped(places, {count}), "stiffness and places must be (N,)");
            for (std::size_t i = 0; i < count; ++i)
              need(which.data()[i] >= 0 && which.data()[i] < 3 * p.vertices(), "there are 3 n coordinates");
            p.draw(which.data(), stiffness.data(), places.data(), int(count));
          },
          nb::arg("which"), nb::arg("stiffness"), nb::arg("places"),
          "Until the next begin, let springs [N/m] draw some of the 3 n coordinates to places [m].")
      .def(
          "evaluate",
          [](Potential& p, Flat x, FlatOut gradient) {
            need_flat(p.vertices(), x, gradient);
            return p.evaluate(x.data(), gradient.data());
          },
          "Energy [J]; writes its gradient [N].");

  nb::class_<Contact>(m, "Contact")
      .def(nb::init<Sheet, double>(), nb::arg("sheet"), nb::arg("slack"))
      .def("begin",
           [](Contact& c, Flat start, Flat base, Ends bodies_start, Ends bodies_base, Ends bodies_end, double tau) {
             need_flat(c.vertices(), start, base);
             for (const auto& b : {bodies_start, bodies_base, bodies_end})
               need(shaped(b, {std::size_t(c.bodies()), 2, 3}), "bodies must be (C, 2, 3)");
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
             need(shaped(mass, {std::size_t(c.vertices())}), "mass must be (n,)");
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
