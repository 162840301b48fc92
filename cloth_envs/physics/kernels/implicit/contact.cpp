#include "contact.hpp"

#include <algorithm>
#include <cmath>

#include "../sheet/drives.hpp"

namespace minicloth {
namespace {

constexpr double kStill = 1e-12;  // m; less slip than this is none

}  // namespace

Contact::Contact(const Sheet& sheet, double slack)
    : n_(sheet.rows * sheet.cols),
      slack_(slack),
      bodies_(sheet.bodies),
      turn_(sheet.bodies.size()),
      x_start_(3 * n_),
      x_base_(3 * n_) {
  for (Body& body : bodies_) body.radius += sheet.thickness;
  load_.assign(n_, 0.0), hold_.assign(n_, kFree), body_.assign(n_, -1);
  for (std::size_t h = 0; h < sheet.handles.size(); ++h)
    if (std::isinf(sheet.hold[3 * h])) hold_[sheet.handles[h]] = kSticks;
}

void Contact::begin(const double* start, const double* base, const double* bodies_start, const double* bodies_base,
                    const double* bodies_end, double tau) {
  tau_ = tau;
  std::copy_n(start, 3 * n_, x_start_.data()), std::copy_n(base, 3 * n_, x_base_.data());
  const std::size_t count = bodies_.size();
  for (auto [from, to] :
       {std::pair{bodies_start, &start_}, std::pair{bodies_base, &base_}, std::pair{bodies_end, &end_}}) {
    to->resize(count);
    for (std::size_t b = 0; b < count; ++b) std::copy_n(from + 6 * b, 6, &(*to)[b].p[0][0]);
  }
  for (std::size_t b = 0; b < count; ++b)
    if (const int with = bodies_[b].turns_with; with >= 0)
      turn_[b] = turned(base_[b].p, end_[b].p, base_[with].p, end_[with].p);
  for (int i = 0; i < n_; ++i)
    if (body_[i] >= 0) hold_[i] = kFree, body_[i] = -1, load_[i] = 0;
}

Contact::Point Contact::at(const double* x, int i) const { return {x[i], x[n_ + i], x[2 * n_ + i]}; }

void Contact::put(double* x, int i, const Point& p) const { x[i] = p.x, x[n_ + i] = p.y, x[2 * n_ + i] = p.z; }

Contact::Hit Contact::hit(int body, const Point& x) const {
  const auto& ends = end_[body].p;
  const double radius = bodies_[body].radius;
  if (bodies_[body].plane) {
    const Point normal = vec(ends[1]);
    return {normal, dot(normal, x - vec(ends[0])) - radius, 0};
  }
  const double s = nearest(ends, x);
  const Point away = x - axis_point(ends, s);
  const double size = std::sqrt(dot(away, away)), scale = size > 0 ? size : 1;
  return {away / scale, size - radius, s};
}

// Where a vertex would be that has moved with the body since the base of the stage.
Contact::Point Contact::anchor(int i, int body, double s) const {
  const auto &from = base_[body].p, &to = end_[body].p;
  const Point carried = at(x_base_.data(), i) + (1 - s) * (vec(to[0]) - vec(from[0]));
  if (bodies_[body].plane) return carried;
  const Point arm = at(x_base_.data(), i) - axis_point(from, nearest(from, at(x_base_.data(), i)));
  return carried + s * (vec(to[1]) - vec(from[1])) + cross(turn_[body], arm);
}

// Onto the surface, along the normal there.
Contact::Point Contact::placed(int body, const Point& x) const {
  const Hit h = hit(body, x);
  return x - h.gap * h.normal;
}

// Whether the vertex is inside the body, or passed through the half of it that it came from; then x is moved
// to the tangent plane where it came in (if it is behind the middle) and onto the surface.
bool Contact::enters(int b, int i, Point& x) const {
  const Hit h = hit(b, x);
  if (bodies_[b].plane) {
    if (h.gap >= 0) return false;
    x = placed(b, x);
    return true;
  }
  // In the frame of the nearest point of the axis the vertex went from p0 to p1.
  const double radius = bodies_[b].radius;
  const Point from = at(x_start_.data(), i);
  const auto& then = start_[b].p;
  const Point p0 = from - axis_point(then, nearest(then, from)), p1 = (h.gap + radius) * h.normal, way = p1 - p0;
  const double outside = dot(p0, p0) - radius * radius, along = dot(p0, way);
  Point n = p0;
  if (outside > 0) {
    const double root = along * along - dot(way, way) * outside;
    if (root > 0 && along < 0) {
      const double time = outside / (std::sqrt(root) - along);
      n = n + std::min(time, 1.0) * way;
      if (time > 1 && h.gap >= 0) return false;
    } else if (h.gap >= 0) {
      return false;
    }
  }
  const double size = std::sqrt(dot(n, n)), front = size > 0 ? dot(n, p1) / size : 0.0;
  if (front > 0 && h.gap >= 0) return false;  // it went round
  if (front <= 0 && size > 0) x = x + (radius - front) * n / size;
  x = placed(b, x);
  return true;
}

// Displacement along the surface from where the body would have carried the vertex.
Contact::Point Contact::slip(int i, int body, const Hit& h, const Point& x) const {
  const Point moved = x - anchor(i, body, h.s);
  return moved - dot(moved, h.normal) * h.normal;
}

void Contact::project(const double* from, double* x) const {
  if (bodies_.empty()) return;
  for (int i = 0; i < n_; ++i) {
    const int held = body_[i];
    if (held < 0 && hold_[i] != kFree) continue;
    Point here = at(x, i);
    if (held >= 0) {
      here = placed(held, here);
      if (bodies_[held].friction > 0) {
        // A slip that would turn round ends at rest.
        const Point old = at(from, i);
        const Hit h = hit(held, here);
        const Point before = slip(i, held, hit(held, old), old), after = slip(i, held, h, here);
        if (dot(before, before) > kStill * kStill && dot(before, after) <= 0) here = placed(held, anchor(i, held, h.s));
      }
    }
    for (int b = 0; b < int(bodies_.size()); ++b)
      if (b != held) enters(b, i, here);
    put(x, i, here);
  }
}

double Contact::classify(const double* x, const double* g, const double* mass, double* free_gradient) {
  double most = 0;
  for (int i = 0; i < n_; ++i) {
    Point f = at(g, i);
    if (body_[i] < 0 && hold_[i] != kFree) {  // a firm handle
      put(free_gradient, i, {0, 0, 0});
      continue;
    }
    if (!bodies_.empty()) {
      const Point here = at(x, i);
      hold_[i] = kFree, body_[i] = -1, load_[i] = 0;
      Hit pressed = {};
      for (int b = 0; b < int(bodies_.size()); ++b) {
        const Hit h = hit(b, here);
        const double load = dot(h.normal, f);
        if (h.gap <= slack_ && load > load_[i]) load_[i] = load, body_[i] = b, pressed = h;
      }
      if (const int b = body_[i]; b >= 0) {
        const double most_friction = bodies_[b].friction * load_[i];
        f = f - load_[i] * pressed.normal;
        const Point u = slip(i, b, pressed, here);
        const double way = std::sqrt(dot(u, u)), pull = std::sqrt(dot(f, f));
        hold_[i] = kSlides;
        if (way > kStill)
          f = f + most_friction * u / way;
        else if (pull > most_friction)
          f = (1 - most_friction / pull) * f;
        else
          hold_[i] = kSticks, f = {0, 0, 0};
      }
    }
    most = std::max(most, dot(f, f) / (mass[i] * mass[i]));
    put(free_gradient, i, f);
  }
  return std::sqrt(most);
}

double Contact::friction(const double* x, double* g) const {
  double energy = 0;
  for (int i = 0; i < n_; ++i) {
    const int b = body_[i];
    if (b < 0) continue;
    const Point here = at(x, i), u = slip(i, b, hit(b, here), here);
    const double most = bodies_[b].friction * load_[i], way = std::sqrt(dot(u, u));
    energy += most * way;
    if (way > kStill) put(g, i, at(g, i) + most * u / way);
  }
  return energy;
}

void Contact::confine(const double* x, double* d) const {
  for (int i = 0; i < n_; ++i) {
    if (hold_[i] == kSticks) put(d, i, {0, 0, 0});
    if (hold_[i] != kSlides) continue;
    const Point normal = hit(body_[i], at(x, i)).normal, way = at(d, i);
    put(d, i, way - dot(normal, way) * normal);
  }
}

void Contact::finish(const double* x, const double* g, const double* free_gradient, double* v, double* reaction) const {
  for (int i = 0; i < n_; ++i) {
    const int b = body_[i];
    put(reaction, i, b < 0 ? Point{0, 0, 0} : at(g, i) - at(free_gradient, i));
    if (b < 0) continue;
    const Hit h = hit(b, at(x, i));
    const Point carried = (anchor(i, b, h.s) - at(x_base_.data(), i)) / tau_, own = at(v, i);
    put(v, i, hold_[i] == kSticks ? carried : own + dot(h.normal, carried - own) * h.normal);
  }
}

}  // namespace minicloth
