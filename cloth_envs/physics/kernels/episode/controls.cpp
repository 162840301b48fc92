// What an action becomes, as small as measures.cpp.
#include <algorithm>
#include <cmath>

#include "../base/arrays.hpp"
#include "../module.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <class T>
using Pairs = Strided<T, 2>;
using Row = In<double, 1>;
using Tones = In<double, 4>;
using Numbers = Strided<double, 1>;

// The mean of the sines of signal s of cloth b at a time.
double blow(const Tones& tones, std::size_t b, std::size_t s, double time) {
  const std::size_t count = tones.shape(3);
  double sum = 0;
  for (std::size_t i = 0; i < count; ++i) sum += std::sin(tones(b, 0, s, i) * time + tones(b, 1, s, i));
  return sum / double(count);
}

// Means of sines, (B, J): signal j of the tones (B, 2, S, N) at time j of (B, K), where S or K may be 1.
Array gust(Tones tones, Pairs<double> time) {
  const std::size_t batch = tones.shape(0), signals = tones.shape(2), times = time.shape(1);
  if (time.shape(0) != batch || (signals != times && signals != 1 && times != 1))
    throw nb::value_error("tones must be (B, 2, S, N), times (B, K) with S = K or either 1");
  const std::size_t n = std::max(signals, times);
  Array out = fresh({batch, n});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t j = 0; j < n; ++j)
      out.data()[b * n + j] = blow(tones, b, signals == 1 ? 0 : j, time(b, times == 1 ? 0 : j));
  return out;
}

// A level wind of a mean speed and heading whose first gust swells it and whose second turns it, (B, 3).
Array gusty_wind(Tones tones, Numbers time, Numbers speed, Numbers heading, double swell, double turn) {
  const std::size_t batch = tones.shape(0);
  if (tones.shape(2) != 2 || time.shape(0) != batch || speed.shape(0) != batch || heading.shape(0) != batch)
    throw nb::value_error("tones must be (B, 2, 2, N), times, speeds and headings (B,)");
  Array out = fresh({batch, 3});
  for (std::size_t b = 0; b < batch; ++b) {
    const double strength = speed(b) * (1 + swell * blow(tones, b, 0, time(b)));
    const double angle = heading(b) + turn * blow(tones, b, 1, time(b));
    out.data()[3 * b] = strength * std::cos(angle), out.data()[3 * b + 1] = strength * std::sin(angle);
  }
  return out;
}

// Moves the handles (B, N, 3) of Controls: axis k of handle i takes share (i, k) of moved and reached (B, n).
void carry(Out<double, 3> handles, Out<double, 3> velocities, Pairs<double> moved, Pairs<double> reached,
           Pairs<double> share) {
  const std::size_t batch = moved.shape(0), n = moved.shape(1), count = share.shape(0);
  if (handles.size() != batch * count * 3 || share.shape(1) != n || n > 3)
    throw nb::value_error("share must be (N, n), moved (B, n) with n as driven");
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t k = 0; k < n; ++k) {
        const std::size_t at = (b * count + i) * 3 + k;
        handles.data()[at] += moved(b, k) * share(i, k);
        velocities.data()[at] += reached(b, k) * share(i, k);
      }
}

// Moves the first of the bodies (B, C, 2, 3), which is at rest, along as many axes as moved and reached (B, n) have.
void push(Out<double, 4> bodies, Out<double, 4> velocities, Pairs<double> moved, Pairs<double> reached) {
  const std::size_t batch = moved.shape(0), n = moved.shape(1), count = bodies.shape(1);
  need(count > 0 && shaped(bodies, {batch, count, 2, 3}) && shaped(velocities, {batch, count, 2, 3}),
       "bodies must be (B, C, 2, 3)");
  need(shaped(reached, {batch, n}) && n <= 3, "moved and reached must be (B, n)");
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t end = 0; end < 2; ++end)
      for (std::size_t k = 0; k < n; ++k) {
        bodies(b, 0, end, k) += moved(b, k);
        velocities(b, 0, end, k) += reached(b, k);
      }
}

// A pressure that goes a share of the way to what the action asks for, `full` at 1, (B,).
Array pump(Numbers pressure, Numbers action, double full, double share) {
  const std::size_t batch = pressure.shape(0);
  need(action.shape(0) == batch, "pressures and actions must be (B,)");
  Array out = fresh({batch});
  for (std::size_t b = 0; b < batch; ++b) out.data()[b] = pressure(b) + share * (full * action(b) - pressure(b));
  return out;
}

// Some vertices of a cloth, (B, N, 3).
template <class T>
Array take_points(In<T, 4> x, In<int, 1> vertices) {
  const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = vertices.shape(0);
  Array out = fresh({batch, count, 3});
  double* to = out.data();
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t k = 0; k < 3; ++k) *to++ = x.data()[(3 * b + k) * n + vertices.data()[i]];
  return out;
}

// What brings every handle and body to rest where it is: the arguments of Controls.
template <class T>
nb::tuple hold(In<T, 4> x, In<int, 1> handles, In<T, 4> colliders) {
  const std::size_t batch = x.shape(0), bodies = colliders.shape(1);
  Array at = fresh({batch, bodies, 2, 3});
  std::copy_n(colliders.data(), colliders.size(), at.data());
  return nb::make_tuple(take_points(x, handles), fresh({batch, handles.shape(0), 3}), at, fresh({batch, bodies, 2, 3}),
                        fresh({batch, 3}), fresh({batch}));
}

// The velocity goes towards action * speed by at most `change`, slowing down within `brake` of a side.
template <class T>
nb::tuple drive(Pairs<T> position, Pairs<T> velocity, Pairs<double> action, Row low, Row high, Row speed, double change,
                double brake, double dt) {
  const std::size_t batch = position.shape(0), n = low.shape(0);
  if (position.shape(1) != n || velocity.shape(1) != n || action.shape(1) != n || high.shape(0) != n ||
      speed.shape(0) != n || velocity.shape(0) != batch || action.shape(0) != batch)
    throw nb::value_error("positions, velocities and actions must be (B, n) with n as in the box");
  Array moved = fresh({batch, n}), reached = fresh({batch, n});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t k = 0; k < n; ++k) {
      const double x = position(b, k), v = velocity(b, k);
      const double upper = std::max((high(k) - x) / brake, 0.0), lower = std::min((low(k) - x) / brake, 0.0);
      const double wanted = std::min(std::max(action(b, k) * speed(k), lower), upper);
      const double next = std::min(std::max(wanted, v - change), v + change);
      moved.data()[b * n + k] = 0.5 * dt * (v + next);
      reached.data()[b * n + k] = next;
    }
  return nb::make_tuple(moved, reached);
}

// Actions clipped to [-1, 1], or None if one is not finite.
nb::object clip_actions(Pairs<double> actions) {
  const std::size_t batch = actions.shape(0), n = actions.shape(1);
  Array out = fresh({batch, n});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t k = 0; k < n; ++k) {
      const double a = actions(b, k);
      if (!std::isfinite(a)) return nb::none();
      out.data()[b * n + k] = std::min(std::max(a, -1.0), 1.0);
    }
  return nb::cast(out);
}

template <class T>
void bind_controls_of(nb::module_& m) {
  m.def("hold", &hold<T>, "The arrays of Controls that bring every handle and body to rest where it is.");
  m.def("drive", &drive<T>, "How far a driven thing moves in a frame, and its velocity at the end, (B, n) each.");
}

}  // namespace

void bind_controls(nb::module_& m) {
  bind_controls_of<float>(m);
  bind_controls_of<double>(m);
  m.def("clip_actions", &clip_actions, "Actions (B, A) clipped to [-1, 1]; None if one is not finite.");
  m.def("gusty_wind", &gusty_wind, "A level wind (B, 3) whose two gusts change its strength and heading.");
  m.def("carry", &carry, "Moves handles in place by shares of how far and how fast something is driven.");
  m.def("push", &push, "Moves the first body in place by how far and how fast something is driven.");
  m.def("pump", &pump, "A pressure (B,) a share of the way further to what the action asks for.");
  m.def("gust", &gust, "Smooth signals in [-1, 1], (B, J), from tones (B, 2, S, N) at times (B, K).");
}

}  // namespace minicloth
