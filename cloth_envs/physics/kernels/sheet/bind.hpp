// How a frame crosses from Python: as a State before it, one to fill and the Controls, whose arrays are read by name.
#pragma once
#include <array>
#include <string>
#include <vector>

#include "../base/arrays.hpp"
#include "sheet.hpp"

namespace minicloth {

struct PythonState {
  nanobind::handle object;
};
struct PythonControls {
  nanobind::handle object;
};

// Frames of a batch; keeps their arrays alive.
template <class T>
class Frames {
 public:
  Frames(const Sheet& sheet, const PythonState& old, const PythonState& now, const PythonControls& controls) {
    enum { kX, kV, kBodyX, kBodyV, kHandleX, kHandleV, kWind, kPressure };
    static PyObject* const names[] = {PyUnicode_InternFromString("positions"),
                                      PyUnicode_InternFromString("velocities"),
                                      PyUnicode_InternFromString("colliders"),
                                      PyUnicode_InternFromString("collider_velocities"),
                                      PyUnicode_InternFromString("handle_positions"),
                                      PyUnicode_InternFromString("handle_velocities"),
                                      PyUnicode_InternFromString("wind"),
                                      PyUnicode_InternFromString("pressure")};
    const auto x = get<In<T, 4>>(old.object, names[kX]), v = get<In<T, 4>>(old.object, names[kV]);
    const auto body_x = get<In<T, 4>>(old.object, names[kBodyX]), body_v = get<In<T, 4>>(old.object, names[kBodyV]);
    const auto x_out = get<Out<T, 4>>(now.object, names[kX]), v_out = get<Out<T, 4>>(now.object, names[kV]);
    const nanobind::handle given = controls.object;
    const auto handle_x = get<In<double, 3>>(given, names[kHandleX]);
    const auto handle_v = get<In<double, 3>>(given, names[kHandleV]);
    const auto body_x_end = get<In<double, 4>>(given, names[kBodyX]);
    const auto body_v_end = get<In<double, 4>>(given, names[kBodyV]);
    const auto wind = get<In<double, 2>>(given, names[kWind]);
    const auto pressure = get<In<double, 1>>(given, names[kPressure]);

    const std::size_t batch = x.shape(0), rows = sheet.rows, cols = sheet.cols, n = 3 * rows * cols;
    const std::size_t handles = sheet.handles.size(), bodies = sheet.bodies.size();
    const std::initializer_list<std::size_t> cloth = {batch, 3, rows, cols}, held = {batch, handles, 3},
                                             axes = {batch, bodies, 2, 3};
    need(shaped(x, cloth) && shaped(v, cloth) && shaped(x_out, cloth) && shaped(v_out, cloth),
         "positions and velocities must be (B, 3, H, W)");
    need(shaped(handle_x, held) && shaped(handle_v, held), "handles must be (B, N, 3)");
    need(shaped(body_x, axes) && shaped(body_v, axes) && shaped(body_x_end, axes) && shaped(body_v_end, axes),
         "colliders must be (B, C, 2, 3)");
    need(shaped(wind, {batch, 3}) && shaped(pressure, {batch}), "wind must be (B, 3), pressure (B,)");
    all_.reserve(batch);
    for (std::size_t b = 0; b < batch; ++b) {
      const std::size_t h = b * handles * 3, c = b * bodies * 6;
      all_.push_back({x.data() + b * n, v.data() + b * n, x_out.data() + b * n, v_out.data() + b * n, body_x.data() + c,
                      body_v.data() + c, handle_x.data() + h, handle_v.data() + h, body_x_end.data() + c,
                      body_v_end.data() + c, wind.data() + 3 * b, pressure.data()[b]});
    }
  }
  const std::vector<Frame<T>>& operator()() const { return all_; }

 private:
  template <class A>
  A get(nanobind::handle object, PyObject* name) {
    const nanobind::object found = nanobind::steal(PyObject_GetAttr(object.ptr(), name));
    if (!found.is_valid()) nanobind::raise_python_error();
    PyObject* array = A::fitting(found.ptr());
    if (!array)
      throw nanobind::type_error(
          (std::string(nanobind::borrow<nanobind::str>(name).c_str()) +
           " must be an array with as many axes as it has in cloth_envs.state, in C order and of " +
           "the solver's dtype where it is filled")
              .c_str());
    kept_[count_++] = nanobind::steal(array);
    return A(reinterpret_cast<PyArrayObject*>(array));
  }
  std::array<nanobind::object, 12> kept_;
  int count_ = 0;
  std::vector<Frame<T>> all_;
};

}  // namespace minicloth

namespace nanobind::detail {

template <>
struct type_caster<minicloth::PythonState> {
  NB_TYPE_CASTER(minicloth::PythonState, const_name("cloth_envs.state.State"))
  bool from_python(handle source, std::uint8_t, cleanup_list*) noexcept { return value.object = source, true; }
};

template <>
struct type_caster<minicloth::PythonControls> {
  NB_TYPE_CASTER(minicloth::PythonControls, const_name("cloth_envs.state.Controls"))
  bool from_python(handle source, std::uint8_t, cleanup_list*) noexcept { return value.object = source, true; }
};

}  // namespace nanobind::detail
