// Where cloth is so even that its cells do not meet those beside them.
#pragma once
#include <cstdlib>

#include "near.hpp"

namespace minicloth {

constexpr double kSmall = 0.3;  // of the rest area, of cells whose normals tell little
constexpr double kLevel = 0.2;  // least cosine between neighbours' normals where cells up to kApart apart do not meet
constexpr double kPlain = 0.8;  // the same of a cell's two triangles
constexpr double kFlat = 0.35;  // least part of the rest area that cells of flat blocks have along a common normal
constexpr int kApart = 2;

// Of cell i of a block, the cells up to kApart apart in the block dr - 1, dc - 1 blocks further.
struct Around {
  std::uint16_t cells[3][3][kCells] = {};
  Around() {
    for (int block = 0; block < 9; ++block)
      for (int i = 0; i < kCells; ++i)
        for (int j = 0; j < kCells; ++j) {
          const int r = (block / 3 - 1) * kSide + j / kSide - i / kSide,
                    c = (block % 3 - 1) * kSide + j % kSide - i % kSide;
          const bool near = std::abs(r) <= kApart && std::abs(c) <= kApart;
          cells[block / 3][block % 3][i] |= std::uint16_t(near << j);
        }
  }
};

}  // namespace minicloth
