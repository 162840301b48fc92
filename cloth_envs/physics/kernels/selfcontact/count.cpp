#include "count.hpp"

#include <algorithm>

#include "crossing.hpp"

namespace minicloth {

namespace {

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
  if (cross_each_other(p, normals_[a], q, normals_[b])) found_.push_back({std::min(a, b), std::max(a, b)});
}

template const std::vector<Crossings::Pair>& Crossings::find(const float*);
template const std::vector<Crossings::Pair>& Crossings::find(const double*);

}  // namespace minicloth
