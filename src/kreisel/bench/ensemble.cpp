// Ensembles of each map, n = 3: LANES trajectories in a register, CHAINS registers side by side, the time loop
// innermost, so that nothing touches memory from the first step to the last.  lanes is a multiple of LANES * CHAINS.

#ifdef __AVX512F__
#define LANES 8
#else
#define LANES 4
#endif
typedef double Real __attribute__((vector_size(8 * LANES)));
#include "maps.hpp"

template <class Map, int C, int CHAINS> static void march(double *z, const double *c, long first, long steps) {
    constexpr int D = 6;
    alignas(64) Real zz[CHAINS][D], cc[CHAINS][C];
    for (int k = 0; k < CHAINS; ++k)
        for (int l = 0; l < LANES; ++l) {
            const long lane = first + k * LANES + l;
            for (int j = 0; j < D; ++j) zz[k][j][l] = z[lane * D + j];
            for (int j = 0; j < C; ++j) cc[k][j][l] = c[lane * C + j];
        }
    constexpr int K1 = CHAINS > 1 ? 1 : 0, K2 = CHAINS > 2 ? 2 : 0, K3 = CHAINS > 3 ? 3 : 0;
    Map one(zz[0], cc[0]), two(zz[K1], cc[K1]), three(zz[K2], cc[K2]), four(zz[K3], cc[K3]);
    for (long s = 0; s < steps; ++s) {
        one.step();
        if constexpr (CHAINS > 1) two.step();
        if constexpr (CHAINS > 2) three.step();
        if constexpr (CHAINS > 3) four.step();
    }
    one.store(zz[0]);
    if constexpr (CHAINS > 1) two.store(zz[1]);
    if constexpr (CHAINS > 2) three.store(zz[2]);
    if constexpr (CHAINS > 3) four.store(zz[3]);
    for (int k = 0; k < CHAINS; ++k)
        for (int l = 0; l < LANES; ++l)
            for (int j = 0; j < D; ++j) z[(first + k * LANES + l) * D + j] = zz[k][j][l];
}

#define EXPORT(name, Map, C, CHAINS)                                                                                 \
    extern "C" void name##_##CHAINS(double *z, const double *c, long lanes, long steps) {                            \
        for (long first = 0; first < lanes; first += LANES * CHAINS)                                                 \
            march<Map, C, CHAINS>(z, c, first, steps);                                                               \
    }
#define EXPORTS(name, Map, C)                                                                                        \
    EXPORT(name, Map, C, 1)                                                                                          \
    EXPORT(name, Map, C, 2)                                                                                          \
    EXPORT(name, Map, C, 3)                                                                                          \
    EXPORT(name, Map, C, 4)

EXPORTS(lagrange_top, LagrangeTop, 5)
EXPORTS(lagrange_top_moving, LagrangeTopMoving, 5)
EXPORTS(symmetric_top, SymmetricTop, 4)
EXPORTS(clebsch, Clebsch, 4)
EXPORTS(neumann, Neumann, 4)

extern "C" void dependent_additions(long count) { // one cycle each, a hundred in a turn
    long x = 1;
    for (long k = 0; k < count; ++k)
        asm volatile(".rept 100\n\tadd %0, %0\n\t.endr" : "+r"(x));
}
