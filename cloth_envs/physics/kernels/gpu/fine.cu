// The entry of fine.hpp: a block for every kCloths of them.
extern "C" __global__ void __launch_bounds__(MINICLOTH_THREADS)
    minicloth_fine(std::size_t members, std::size_t room, const int* counts, const minicloth::CardBody* bodies,
                   const float* x, const float* v, const double* driven, const double* driving, const float* body_x,
                   const float* body_v, const float* weights, const float* bias, const int* cells, const float* free,
                   const int* base_at, const float* base_by, const int* speeds_at, const float* speeds_by,
                   const int* said_at, const float* said_by, const int* held_at, const float* held_by,
                   const int* places, float* x_out, float* v_out, float* said) {
  using namespace minicloth;
  const FineBatch batch = {members,
                           room,
                           counts,
                           bodies,
                           x,
                           v,
                           driven,
                           driving,
                           body_x,
                           body_v,
                           weights,
                           bias,
                           cells,
                           free,
                           {base_at, base_by},
                           {speeds_at, speeds_by},
                           {said_at, said_by},
                           {held_at, held_by},
                           places,
                           x_out,
                           v_out,
                           said};
  extern __shared__ __align__(16) unsigned char memory[];
  const std::size_t first = std::size_t(LANES::kCloths) * blockIdx.x;
  const LANES::Drawn drawn(LANES::kSheet, memory, said + 3 * LANES::kSaid * counts[LANES::kCells] * first);
  LANES::Crew crew;
  LANES::fine(LANES::kSheet, batch, first, drawn, crew);
}
