// One trajectory of each map, n = 3.

typedef double Real;
#include "maps.hpp"

template <class Map> static void advance(double *z, const double *c, long steps) {
    Map map(z, c);
    for (long k = 0; k < steps; ++k)
        map.step();
    map.store(z);
}

#define EXPORT(name, Map)                                                                                            \
    extern "C" void name(double *z, const double *c, long steps) { advance<Map>(z, c, steps); }

EXPORT(lagrange_top, LagrangeTop)
EXPORT(lagrange_top_moving, LagrangeTopMoving)
EXPORT(symmetric_top, SymmetricTop)
EXPORT(clebsch, Clebsch)
EXPORT(neumann, Neumann)
