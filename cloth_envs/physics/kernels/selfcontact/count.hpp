// Pairs of a cloth's triangles that cross each other.
#pragma once
#include <array>
#include <vector>

#include "../base/vec.hpp"

namespace minicloth {

// Finds them in cloths of one grid; keeps its memory from cloth to cloth. Triangles are those of Grid.triangles in
// cloth_envs.grid: of cell k the lower one is 2 k, the upper one 2 k + 1.
class Crossings {
 public:
  using Pair = std::array<int, 2>;
  Crossings(int rows, int cols, bool periodic);
  // Of positions (3, H, W) [m], all finite: pairs without a common vertex of which an edge of one crosses the inside
  // of the other, told in double; touching is no crossing. In ascending order, the smaller number first.
  template <class T>
  const std::vector<Pair>& find(const T* x);

 private:
  struct Box {
    double low[3], high[3];
  };
  struct Node {
    int level, row, col;  // level 0: cells
  };
  struct Level {
    int rows, cols, first;  // number of its first box
  };
  Box& box(const Node& n) { return boxes_[levels_[n.level].first + n.row * levels_[n.level].cols + n.col]; }
  void within(const Node& node);
  void between(const Node& a, const Node& b);
  void test(int a, int b);
  int children(const Node& node, Node (&out)[4]) const;

  int rows_, cols_;
  std::vector<std::array<int, 3>> triangles_;
  std::vector<Level> levels_;
  std::vector<Box> boxes_, triangle_boxes_;
  std::vector<Vec<double>> at_, normals_;
  std::vector<Pair> found_;
};

}  // namespace minicloth
