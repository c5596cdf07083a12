// As much of LAMMPS as examples/engines/fix_kreisel.cpp calls, with its names: the base classes Pointers and Fix.
#pragma once
#include "atom.h"
#include "update.h"
namespace LAMMPS_NS {
struct LAMMPS {
    Atom *atom;
    Update *update;
};
class Pointers {
public:
    explicit Pointers(LAMMPS *lmp) : lmp(lmp), atom(lmp->atom), update(lmp->update) {}
    virtual ~Pointers() = default;

protected:
    LAMMPS *lmp;
    Atom *&atom;
    Update *&update;
};
namespace FixConst {
enum { INITIAL_INTEGRATE = 1 << 0, FINAL_INTEGRATE = 1 << 4 };
}
class Fix : protected Pointers {
public:
    int groupbit = 1;
    Fix(LAMMPS *lmp, int, char **) : Pointers(lmp) {}
    virtual int setmask() = 0;
    virtual void initial_integrate(int) {}
    virtual void final_integrate() {}
};
}  // namespace LAMMPS_NS
