#include "count.hpp"

#include <algorithm>

namespace minicloth {

namespace {

Vec<double> cross(const Vec<double>& a, const Vec<double>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

template <class Box>
bool apart(const Box& a, const Box& b) {
  bool far = false;
  for (int k = 0; k < 3; ++k) far |= (a.low[k] > b.high[k]) | (b.low[k] > a.high[k]);
  return far;
}

template <class Box>
void include(Box& box, const Box& other) {
  for (int k = 0; k < 3; ++k) {
    box.low[k] = std::min(box.low[k], other.low[k]);
    box.high[k] = std::max(box.high[k], other.high[k]);
  }
}

// Whether the line from p to q passes inside of the triangle's edges.
bool inside(const Vec<double>& p, const Vec<double>& q, const Vec<double> (&t)[3]) {
  const Vec<double> way = q - p, a = t[0] - p, b = t[1] - p, c = t[2] - p;
  const double u = dot(way, cross(a, b)), v = dot(way, cross(b, c)), w = dot(way, cross(c, a));
  return (u > 0 && v > 0 && w > 0) || (u < 0 && v < 0 && w < 0);
}

// Whether an edge of t, whose corners are at signed distances d from the plane of f, crosses the inside of f.
bool crosses(const Vec<double> (&t)[3], const double (&d)[3], const Vec<double> (&f)[3]) {
  for (int k = 0; k < 3; ++k) {
    const int next = k == 2 ? 0 : k + 1;
    if (((d[k] < 0 && d[next] > 0) || (d[k] > 0 && d[next] < 0)) && inside(t[k], t[next], f)) return true;
  }
  return false;
}

// Signed distances of t's corners from the plane through a point with a normal, times its length; whether some lie on
// either side.
bool sides(const Vec<double> (&t)[3], const Vec<double>& point, const Vec<double>& normal, double (&d)[3]) {
  for (int k = 0; k < 3; ++k) d[k] = dot(normal, t[k] - point);
  return std::min({d[0], d[1], d[2]}) < 0 && std::max({d[0], d[1], d[2]}) > 0;
}

}  // namespace

Crossings::Crossings(int rows, int cols, bool periodic) : rows_(rows), cols_(cols) {
  int down = rows - 1, along = periodic ? cols : cols - 1, first = 0;
  for (int r = 0; r < down; ++r)
    for (int c = 0; c < along; ++c) {
      const int upper_left = r * cols + c, upper_right = r * cols + (c + 1) % cols;
      triangles_.push_back({upper_left, upper_left + cols, upper_right + cols});
      triangles_.push_back({upper_left, upper_right + cols, upper_right});
    }
  for (;; down = (down + 1) / 2, along = (along + 1) / 2) {
    levels_.push_back({down, along, first});
    first += down * along;
    if (down == 1 && along == 1) break;
  }
  boxes_.resize(first);
  triangle_boxes_.resize(triangles_.size());
  at_.resize(std::size_t(rows) * cols);
  normals_.resize(triangles_.size());
}

template <class T>
const std::vector<Crossings::Pair>& Crossings::find(const T* x) {
  const std::size_t n = at_.size();
  for (std::size_t i = 0; i < n; ++i) at_[i] = {double(x[i]), double(x[n + i]), double(x[2 * n + i])};
  for (std::size_t i = 0; i < triangles_.size(); ++i) {
    const Vec<double>&a = at_[triangles_[i][0]], &b = at_[triangles_[i][1]], &c = at_[triangles_[i][2]];
    normals_[i] = cross(b - a, c - a);
    Box& own = triangle_boxes_[i] = {{a.x, a.y, a.z}, {a.x, a.y, a.z}};
    include(own, Box{{b.x, b.y, b.z}, {b.x, b.y, b.z}});
    include(own, Box{{c.x, c.y, c.z}, {c.x, c.y, c.z}});
    if (i % 2) include(boxes_[i / 2] = triangle_boxes_[i - 1], own);
  }
  for (int level = 1; level < int(levels_.size()); ++level)
    for (int r = 0; r < levels_[level].rows; ++r)
      for (int c = 0; c < levels_[level].cols; ++c) {
        Node parts[4];
        const Node node = {level, r, c};
        const int count = children(node, parts);
        box(node) = box(parts[0]);
        for (int k = 1; k < count; ++k) include(box(node), box(parts[k]));
      }
  found_.clear();
  within({int(levels_.size()) - 1, 0, 0});
  std::sort(found_.begin(), found_.end());
  return found_;
}

int Crossings::children(const Node& node, Node (&out)[4]) const {
  const Level& level = levels_[node.level - 1];
  int count = 0;
  for (int r = 2 * node.row; r < std::min(2 * node.row + 2, level.rows); ++r)
    for (int c = 2 * node.col; c < std::min(2 * node.col + 2, level.cols); ++c) out[count++] = {node.level - 1, r, c};
  return count;
}

// All pairs in a block of cells; the two triangles of a cell have an edge in common.
void Crossings::within(const Node& node) {
  if (node.level == 0) return;
  Node parts[4];
  const int count = children(node, parts);
  for (int i = 0; i < count; ++i) {
    within(parts[i]);
    for (int k = 0; k < i; ++k) between(parts[k], parts[i]);
  }
}

void Crossings::between(const Node& a, const Node& b) {
  if (apart(box(a), box(b))) return;
  if (a.level == 0) {
    const int cols = levels_[0].cols, i = 2 * (a.row * cols + a.col), k = 2 * (b.row * cols + b.col);
    test(i, k), test(i, k + 1), test(i + 1, k), test(i + 1, k + 1);
    return;
  }
  Node left[4], right[4];
  const int count = children(a, left), others = children(b, right);
  for (int i = 0; i < count; ++i)
    if (!apart(box(left[i]), box(b)))
      for (int k = 0; k < others; ++k) between(left[i], right[k]);
}

void Crossings::test(int a, int b) {
  if (apart(triangle_boxes_[a], triangle_boxes_[b])) return;
  const auto &i = triangles_[a], &k = triangles_[b];
  for (int corner : i)
    if (corner == k[0] || corner == k[1] || corner == k[2]) return;
  const Vec<double> p[3] = {at_[i[0]], at_[i[1]], at_[i[2]]}, q[3] = {at_[k[0]], at_[k[1]], at_[k[2]]};
  double from_a[3], from_b[3];
  if (!sides(p, q[0], normals_[b], from_b) || !sides(q, p[0], normals_[a], from_a)) return;
  if (crosses(p, from_b, q) || crosses(q, from_a, p)) found_.push_back({std::min(a, b), std::max(a, b)});
}

template const std::vector<Crossings::Pair>& Crossings::find(const float*);
template const std::vector<Crossings::Pair>& Crossings::find(const double*);

}  // namespace minicloth
