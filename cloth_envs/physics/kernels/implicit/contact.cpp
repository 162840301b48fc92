#include "contact.hpp"

#include <algorithm>
#include <cmath>

#include "../sheet/bodies.hpp"

namespace minicloth {
namespace {

constexpr double kStill = 1e-12;  // m; less slip than this is none

double dot(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

}  // namespace

Contact::Contact(const Sheet& sheet, double slack)
    : n_(sheet.rows * sheet.cols), slack_(slack), bodies_(sheet.bodies), x_start_(3 * n_), x_base_(3 * n_) {
  for (Body& body : bodies_) body.radius += sheet.thickness;
  load_.assign(n_, 0.0), hold_.assign(n_, kFree), body_.assign(n_, -1);
  for (int i : sheet.handles) hold_[i] = kSticks;
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
  for (int i = 0; i < n_; ++i)
    if (body_[i] >= 0) hold_[i] = kFree, body_[i] = -1, load_[i] = 0;
}

Contact::Hit Contact::nearest(int body, const double* x) const {
  const auto& ends = end_[body].p;
  Hit hit = {};
  if (bodies_[body].plane) {
    for (int k = 0; k < 3; ++k) hit.normal[k] = ends[1][k], hit.gap += ends[1][k] * (x[k] - ends[0][k]);
    hit.gap -= bodies_[body].radius;
    return hit;
  }
  hit.s = minicloth::nearest(ends, vec(x));
  for (int k = 0; k < 3; ++k) hit.normal[k] = x[k] - (ends[0][k] + hit.s * (ends[1][k] - ends[0][k]));
  const double size = std::sqrt(dot(hit.normal, hit.normal));
  for (double& k : hit.normal) k /= size > 0 ? size : 1;
  hit.gap = size - bodies_[body].radius;
  return hit;
}

// Where a vertex would be that has moved with the body since the base of the stage.
void Contact::anchor(int i, int body, double s, double* out) const {
  const auto &from = base_[body].p, &to = end_[body].p;
  for (int k = 0; k < 3; ++k)
    out[k] = x_base_[k * n_ + i] + (1 - s) * (to[0][k] - from[0][k]) +
             (bodies_[body].plane ? 0.0 : s * (to[1][k] - from[1][k]));
}

// Onto the surface, along the normal there.
void Contact::place(int body, double* x) const {
  const Hit hit = nearest(body, x);
  for (int k = 0; k < 3; ++k) x[k] -= hit.gap * hit.normal[k];
}

// Whether the vertex is inside the body, or passed through the half of it that it came from; then x is moved
// to the tangent plane where it came in (if it is behind the middle) and onto the surface.
bool Contact::enters(int b, int i, double* x) const {
  const Hit hit = nearest(b, x);
  if (bodies_[b].plane) {
    if (hit.gap >= 0) return false;
    place(b, x);
    return true;
  }
  // In the frame of the nearest point of the axis the vertex went from p0 to p1.
  const double radius = bodies_[b].radius, from[3] = {x_start_[i], x_start_[n_ + i], x_start_[2 * n_ + i]};
  const auto& then = start_[b].p;
  const double s = minicloth::nearest(then, vec(from));
  double p0[3], p1[3], way[3];
  for (int k = 0; k < 3; ++k) {
    p0[k] = from[k] - (then[0][k] + s * (then[1][k] - then[0][k]));
    p1[k] = (hit.gap + radius) * hit.normal[k];
    way[k] = p1[k] - p0[k];
  }
  const double outside = dot(p0, p0) - radius * radius, along = dot(p0, way);
  double n[3] = {p0[0], p0[1], p0[2]};
  if (outside > 0) {
    const double root = along * along - dot(way, way) * outside;
    if (root > 0 && along < 0) {
      const double time = outside / (std::sqrt(root) - along);
      for (int k = 0; k < 3; ++k) n[k] += std::min(time, 1.0) * way[k];
      if (time > 1 && hit.gap >= 0) return false;
    } else if (hit.gap >= 0) {
      return false;
    }
  }
  const double size = std::sqrt(dot(n, n)), front = size > 0 ? dot(n, p1) / size : 0.0;
  if (front > 0 && hit.gap >= 0) return false;  // it went round
  if (front <= 0 && size > 0)
    for (int k = 0; k < 3; ++k) x[k] += (radius - front) * n[k] / size;
  place(b, x);
  return true;
}

// Displacement along the surface from where the body would have carried the vertex.
void Contact::slip(int i, int body, const Hit& hit, const double* x, double* out) const {
  double carried[3];
  anchor(i, body, hit.s, carried);
  for (int k = 0; k < 3; ++k) out[k] = x[k] - carried[k];
  const double away = dot(out, hit.normal);
  for (int k = 0; k < 3; ++k) out[k] -= away * hit.normal[k];
}

void Contact::project(const double* from, double* x) const {
  if (bodies_.empty()) return;
  for (int i = 0; i < n_; ++i) {
    const int held = body_[i];
    if (held < 0 && hold_[i] != kFree) continue;
    double at[3] = {x[i], x[n_ + i], x[2 * n_ + i]};
    if (held >= 0) {
      place(held, at);
      if (bodies_[held].friction > 0) {
        // A slip that would turn round ends at rest.
        const double old[3] = {from[i], from[n_ + i], from[2 * n_ + i]};
        double before[3], after[3];
        const Hit hit = nearest(held, at);
        slip(i, held, nearest(held, old), old, before), slip(i, held, hit, at, after);
        if (dot(before, before) > kStill * kStill && dot(before, after) <= 0) {
          anchor(i, held, hit.s, at);
          place(held, at);
        }
      }
    }
    for (int b = 0; b < int(bodies_.size()); ++b)
      if (b != held) enters(b, i, at);
    for (int k = 0; k < 3; ++k) x[k * n_ + i] = at[k];
  }
}

double Contact::classify(const double* x, const double* g, const double* mass, double* free_gradient) {
  double most = 0;
  for (int i = 0; i < n_; ++i) {
    double f[3] = {g[i], g[n_ + i], g[2 * n_ + i]};
    if (body_[i] < 0 && hold_[i] != kFree) {  // a handle
      for (int k = 0; k < 3; ++k) free_gradient[k * n_ + i] = 0;
      continue;
    }
    if (!bodies_.empty()) {
      const double at[3] = {x[i], x[n_ + i], x[2 * n_ + i]};
      hold_[i] = kFree, body_[i] = -1, load_[i] = 0;
      Hit pressed = {};
      for (int b = 0; b < int(bodies_.size()); ++b) {
        const Hit hit = nearest(b, at);
        const double load = dot(hit.normal, f);
        if (hit.gap <= slack_ && load > load_[i]) load_[i] = load, body_[i] = b, pressed = hit;
      }
      if (const int b = body_[i]; b >= 0) {
        const double *n = pressed.normal, most_friction = bodies_[b].friction * load_[i];
        for (int k = 0; k < 3; ++k) f[k] -= load_[i] * n[k];
        double u[3];
        slip(i, b, pressed, at, u);
        const double way = std::sqrt(dot(u, u)), pull = std::sqrt(dot(f, f));
        hold_[i] = kSlides;
        if (way > kStill)
          for (int k = 0; k < 3; ++k) f[k] += most_friction * u[k] / way;
        else if (pull > most_friction)
          for (double& k : f) k *= 1 - most_friction / pull;
        else
          hold_[i] = kSticks, f[0] = f[1] = f[2] = 0;
      }
    }
    most = std::max(most, dot(f, f) / (mass[i] * mass[i]));
    for (int k = 0; k < 3; ++k) free_gradient[k * n_ + i] = f[k];
  }
  return std::sqrt(most);
}

double Contact::friction(const double* x, double* g) const {
  double energy = 0;
  for (int i = 0; i < n_; ++i) {
    const int b = body_[i];
    if (b < 0) continue;
    const double at[3] = {x[i], x[n_ + i], x[2 * n_ + i]}, most = bodies_[b].friction * load_[i];
    double u[3];
    slip(i, b, nearest(b, at), at, u);
    const double way = std::sqrt(dot(u, u));
    energy += most * way;
    if (way > kStill)
      for (int k = 0; k < 3; ++k) g[k * n_ + i] += most * u[k] / way;
  }
  return energy;
}

void Contact::confine(const double* x, double* d) const {
  for (int i = 0; i < n_; ++i) {
    if (hold_[i] == kFree) continue;
    double along = 0;
    Hit hit = {};
    if (hold_[i] == kSlides) {
      const double at[3] = {x[i], x[n_ + i], x[2 * n_ + i]};
      hit = nearest(body_[i], at);
      for (int k = 0; k < 3; ++k) along += hit.normal[k] * d[k * n_ + i];
    }
    for (int k = 0; k < 3; ++k) d[k * n_ + i] = hold_[i] == kSticks ? 0.0 : d[k * n_ + i] - along * hit.normal[k];
  }
}

void Contact::finish(const double* x, const double* g, const double* free_gradient, double* v, double* reaction) const {
  for (int i = 0; i < n_; ++i) {
    const int b = body_[i];
    for (int k = 0; k < 3; ++k) reaction[k * n_ + i] = b < 0 ? 0.0 : g[k * n_ + i] - free_gradient[k * n_ + i];
    if (b < 0) continue;
    const double at[3] = {x[i], x[n_ + i], x[2 * n_ + i]};
    const Hit hit = nearest(b, at);
    double carried[3], along = 0;
    anchor(i, b, hit.s, carried);
    for (int k = 0; k < 3; ++k) carried[k] = (carried[k] - x_base_[k * n_ + i]) / tau_;
    for (int k = 0; k < 3; ++k) along += hit.normal[k] * (carried[k] - v[k * n_ + i]);
    for (int k = 0; k < 3; ++k)
      v[k * n_ + i] = hold_[i] == kSticks ? carried[k] : v[k * n_ + i] + along * hit.normal[k];
  }
}

}  // namespace minicloth
