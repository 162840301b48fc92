// Sheet, Body and Material for Python.
#include "bind.hpp"

#include <nanobind/stl/vector.h>

#include <utility>

#include "../module.hpp"

namespace nb = nanobind;

namespace minicloth {

void bind_sheet(nb::module_& m) {
  nb::class_<Body>(m, "Body", "A ball or capsule, or a plane: its radius [m] and friction.")
      .def(
          "__init__",
          [](Body* self, bool plane, double radius, double friction, int turns_with) {
            new (self) Body{plane, radius, friction, turns_with};
          },
          nb::kw_only(), nb::arg("plane"), nb::arg("radius"), nb::arg("friction"), nb::arg("turns_with"));
  nb::class_<Sheet>(m, "Sheet", "What all cloths of a batch share: the grid, which terms exist, what is driven.")
      .def(
          "__init__",
          [](Sheet* self, int rows, int cols, double row_length, double col_length, bool periodic, double frame_dt,
             double gravity, double thickness, double self_thickness, double self_friction, bool air, bool pressure,
             double air_normal, double air_lift, double air_tangential, std::vector<int> handles,
             std::vector<double> hold, std::vector<int> lead, std::vector<Body> bodies) {
            need(rows >= 1 && cols >= 2, "a sheet has a row and two columns at least");
            for (int h : handles) need(h >= 0 && h < rows * cols, "a handle is not a vertex of the grid");
            need(hold.size() == 3 * handles.size() && lead.size() == handles.size(), "hold must be (N, 3), lead (N,)");
            for (double h : hold) need(h >= 0, "what holds a handle can't be negative");
            need(self_thickness >= 0 && self_friction >= 0, "neither thickness nor friction can be negative");
            for (const Body& body : bodies)
              need(body.turns_with >= -1 && body.turns_with < int(bodies.size()),
                   "a body turns with one of the sheet's");
            for (int h : lead) need(h >= 0 && h < int(handles.size()), "what leads a handle must be a handle");
            new (self) Sheet{rows,
                             cols,
                             row_length,
                             col_length,
                             periodic,
                             frame_dt,
                             gravity,
                             thickness,
                             self_thickness,
                             self_friction,
                             air,
                             pressure,
                             air_normal,
                             air_lift,
                             air_tangential,
                             std::move(handles),
                             std::move(hold),
                             std::move(lead),
                             std::move(bodies)};
          },
          nb::kw_only(), nb::arg("rows"), nb::arg("cols"), nb::arg("row_length"), nb::arg("col_length"),
          nb::arg("periodic"), nb::arg("frame_dt"), nb::arg("gravity"), nb::arg("thickness"), nb::arg("self_thickness"),
          nb::arg("self_friction"), nb::arg("air"), nb::arg("pressure"), nb::arg("air_normal"), nb::arg("air_lift"),
          nb::arg("air_tangential"), nb::arg("handles"), nb::arg("hold"), nb::arg("lead"), nb::arg("bodies"));
  nb::class_<Material>(m, "Material", "One cloth's material, as cloth_envs.material has it.")
      .def(
          "__init__",
          [](Material* self, double areal_density, double stretch_stiffness, double shear_stiffness,
             double bend_stiffness, double damping, double drag, double compression, double buckling_strain,
             double post_buckling, double compression_damping, double twist) {
            new (self) Material{areal_density, stretch_stiffness, shear_stiffness, bend_stiffness,      damping, drag,
                                compression,   buckling_strain,   post_buckling,   compression_damping, twist};
          },
          nb::kw_only(), nb::arg("areal_density"), nb::arg("stretch_stiffness"), nb::arg("shear_stiffness"),
          nb::arg("bend_stiffness"), nb::arg("damping"), nb::arg("drag"), nb::arg("compression"),
          nb::arg("buckling_strain"), nb::arg("post_buckling"), nb::arg("compression_damping"), nb::arg("twist"));
}

}  // namespace minicloth
