// Handles and bodies in a frame; the same cubics as sheet/drives.hpp.
#pragma once
#include "block.hpp"
#include "shared.hpp"

namespace minicloth {
namespace LANES {
namespace {

// Handle h of a cloth, as handles_of: a firm one's path starts where it is, a soft one's where it would be had it moved
// with its lead alone. h is the length of a substep.
inline void begin_handle(const CardSheet& s, const CardBatch& b, const CardCloth& m, int member, int number, double h,
                         Held& held) {
  const int n = s.rows * s.cols;
  const double* const hold = b.hold + 3 * number;
  const double* const end = b.handle_x + std::size_t(3) * s.handles * member;
  const double* const end_v = b.handle_v + std::size_t(3) * s.handles * member;
  held.firm = isinf(hold[0]);
  const int lead = held.firm ? number : b.lead[number];
  float rest[3];
  for (int k = 0; k < 3; ++k) {
    const std::size_t i = std::size_t(3) * n * member + k * n + b.handles[lead];
    const double offset = end[3 * number + k] - end[3 * lead + k];
    const Cubic path = {b.x[i] + offset, b.v[i] * s.frame_dt, end[3 * number + k], end_v[3 * number + k] * s.frame_dt};
    held.p0[k] = float(path.p0), rest[k] = float(path.p0 - held.p0[k]), held.v0[k] = float(path.v0);
    held.c2[k] = float(path.c2), held.c3[k] = float(path.c3);
    const double rate = held.firm ? 0 : hold[k] * (double(m.stretch) / m.density);
    held.rate[k] = float(rate), held.share[k] = float(h * h * rate / (1 + h * h * rate));
  }
  held.rest = {rest[0], rest[1], rest[2]};
}

// Where it should be at t of the frame, from 0 to 1.
inline void move_handle(const CardSheet& s, float t, Held& held) {
  float ahead[3], speed[3];
  const float rate = float(1 / s.frame_dt);
  for (int k = 0; k < 3; ++k) {
    ahead[k] = t * (held.v0[k] + t * (held.c2[k] + t * held.c3[k]));
    speed[k] = rate * (held.v0[k] + t * (2 * held.c2[k] + t * 3 * held.c3[k]));
  }
  held.ahead = held.rest + V3<float>{ahead[0], ahead[1], ahead[2]}, held.speed = {speed[0], speed[1], speed[2]};
}

// From x to where it should be, `ahead` of p0.
inline V3<float> way_of(const Held& held, const V3<float>& x, const V3<float>& ahead) {
  return (V3<float>{held.p0[0], held.p0[1], held.p0[2]} - x) + ahead;
}

// What a soft one's springs, with that way to go, change of its velocity in dt.
inline V3<float> pulled(const Held& held, const V3<float>& way, float dt) {
  return {dt * held.rate[0] * way.x, dt * held.rate[1] * way.y, dt * held.rate[2] * way.z};
}

// At the end of a step of h, 0 at the frame's end: a firm one is put on its path, a soft one drawn there.
inline void hold(const CardSheet& s, const Held& held, float h, V3<float>& x, V3<float>& v) {
  if (!s.soft || held.firm) {
    x = V3<float>{held.p0[0], held.p0[1], held.p0[2]} + held.ahead, v = held.speed;
  } else if (h > 0) {
    const V3<float> way = way_of(held, x, held.ahead);
    const V3<float> drawn = {held.share[0] * way.x, held.share[1] * way.y, held.share[2] * way.z};
    x = x + drawn, v = v + (1 / h) * drawn;
  }
}

inline void begin_body(const CardSheet& s, const CardBatch& b, int member, int number, Driven& body) {
  const std::size_t first = (std::size_t(member) * s.bodies + number) * 6;
  bool sphere = true;
  for (int i = 0; i < 6; ++i) {
    body.path[i] = {b.body_x[first + i], b.body_v[first + i] * s.frame_dt, b.body_x_end[first + i],
                    b.body_v_end[first + i] * s.frame_dt};
    if (i >= 3) sphere = sphere && body.path[i - 3] == body.path[i];
    body.step.after[i / 3][i % 3][0] = float(body.path[i].position(0));
  }
  const CardBody& told = b.bodies[number];
  body.step.shape = told.plane ? Shape::kPlane : sphere ? Shape::kSphere : Shape::kCapsule;
  body.step.radius = float(told.radius), body.step.friction = float(told.friction);
  for (int k = 0; k < 3; ++k) body.step.turn[k][0] = 0;  // none spins: solver.py refuses it
}

// The step from where the last one ended to t of the frame, of dt.
inline void move_body(double t, float dt, Driven& body) {
  for (int i = 0; i < 6; ++i) {
    body.step.before[i / 3][i % 3][0] = body.step.after[i / 3][i % 3][0];
    body.step.after[i / 3][i % 3][0] = float(body.path[i].position(t));
  }
  body.moving = Moving<float>(body.step, dt);
}

// Contact of a vertex that the step took from `start` to x at v with all bodies in turn, and then out of all of them.
inline void keep_out(const CardSheet& s, const Shared& shared, const V3<float>& start, V3<float>& x, V3<float>& v) {
  bool deep = false;
  for (int i = 0; i < s.bodies; ++i) {
    const Driven& body = shared.driven[i];
    if (!may_touch(body.moving, x, x - start)) continue;
    const Vertex<float> now = touch(body.step, body.moving, start, Vertex<float>{x, v});
    x = now.x, v = now.v, deep = s.bodies > 1;
  }
  for (int sweep = 0; deep && sweep < kSweeps; ++sweep) {
    deep = false;
    for (int i = 0; i < s.bodies; ++i) deep |= leave(shared.driven[i].moving, x);
  }
}

}  // namespace
}  // namespace LANES
}  // namespace minicloth
