// What a graphics card is told to draw fine cloths of coarse ones: plain structures, as terms.hpp.
#pragma once
#include "terms.hpp"

namespace minicloth {

constexpr int kMostLayers = 4;

// What all cloths share.
struct FineSheet {
  int rows, cols, handles, bodies;  // of the coarse cloth; of the fine one
  int layers, widths[kMostLayers + 1];
  int spare;                     // whether what the network says waits in `said`, for want of shared memory
  double spacing, limit, reach;  // m; of a residual, in spacings; m, within which a vertex is at a body's surface
};

// Rows of a sparse matrix: entry e of row k is by[e K + k], times number at[e K + k].
struct Sparse {
  const int* at;
  const float* by;
};

// A batch. Cloths (B, 3, h, w), handles (B, N, 3), bodies (B, C, 2, 3); m, m/s.
struct FineBatch {
  std::size_t members, room;  // room: vertices of a cloth in x_out, of which K are written
  const int* counts;          // K vertices that are wanted, cells that a network sees, the most entries of each matrix
  const CardBody* bodies;
  const float *x, *v;
  const double *driven, *driving;
  const float *body_x, *body_v;
  const float* weights;                // of all layers, as a Local has them; each row filled up to a multiple of four
  const float* bias;                   // (B, outputs of all layers)
  const int* cells;                    // the places in the continued sheet of the cells' patches
  const float* free;                   // (K,), 0 of a handle that is put where it is driven, else 1
  Sparse base, speeds, said_by, held;  // of padded positions, velocities, what the network says, handles
  const int* places;                   // (K,), where in x_out each goes
  float *x_out, *v_out;                // (B, 3, room)
  float* said;                         // (B, 27 cells) if `spare`
};

}  // namespace minicloth
