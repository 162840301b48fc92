// How what is driven moves through a frame.
#pragma once

namespace minicloth {

// Cubic Hermite motion over a frame, s from 0 to 1.
struct Cubic {
  double p0, v0, p1, v1;  // v [per frame]
  double c2 = 3 * (p1 - p0) - 2 * v0 - v1, c3 = 2 * (p0 - p1) + v0 + v1;
  double position(double s) const { return p0 + s * (v0 + s * (c2 + s * c3)); }
  double velocity(double s) const { return v0 + s * (2 * c2 + s * 3 * c3); }
  bool operator==(const Cubic& o) const { return p0 == o.p0 && v0 == o.v0 && p1 == o.p1 && v1 == o.v1; }
};

}  // namespace minicloth
