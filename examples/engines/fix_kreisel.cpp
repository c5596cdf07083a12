/* LAMMPS: a fix that integrates the rotation of aspherical particles by the file that `kreisel code` writes.

    kreisel code free-body --set I=1,2,2.5 --language c --name rock > rock.h

A sketch: `fix 1 all kreisel` rotates the ellipsoids, and positions are left to fix nve.  Half of the torque's impulse is
given before the step and half after it, as in the velocity Verlet method.  angmom and torque are along the axes of space.
*/
#include "atom.h"
#include "atom_vec_ellipsoid.h"
#include "fix.h"
#include "update.h"

#include "rock.h"

namespace LAMMPS_NS {

class FixKreisel : public Fix {
public:
    FixKreisel(LAMMPS *lmp, int narg, char **arg) : Fix(lmp, narg, arg) {}

    int setmask() override { return FixConst::INITIAL_INTEGRATE | FixConst::FINAL_INTEGRATE; }

    void initial_integrate(int) override {
        auto *ellipsoids = static_cast<AtomVecEllipsoid *>(atom->avec);
        half_impulse();
        for (int i = 0; i < atom->nlocal; i++) {
            if (!(atom->mask[i] & groupbit) || atom->ellipsoid[i] < 0) continue;
            AtomVecEllipsoid::Bonus &bonus = ellipsoids->bonus[atom->ellipsoid[i]];
            const double *r = bonus.shape, *q = bonus.quat, m = atom->rmass[i] / 5.0;
            const double I[3] = {m * (r[1] * r[1] + r[2] * r[2]), m * (r[0] * r[0] + r[2] * r[2]), m * (r[0] * r[0] + r[1] * r[1])};
            rock_constants c;
            rock_state s = {{0, 0, 0}, {q[0], q[1], q[2], q[3]}, {}, {}};
            rock_prepare(&c, I, update->dt);
            rotate(q, atom->angmom[i], s.M);
            rock_step(&c, &s); /* the momentum in space is constant */
            for (int k = 0; k < 4; k++) bonus.quat[k] = s.g[k];
        }
    }

    void final_integrate() override { half_impulse(); }

private:
    void half_impulse() {
        for (int i = 0; i < atom->nlocal; i++)
            if (atom->mask[i] & groupbit)
                for (int k = 0; k < 3; k++) atom->angmom[i][k] += 0.5 * update->dt * atom->torque[i][k];
    }

    /* v along the axes of the body of attitude q */
    static void rotate(const double *q, const double *v, double *out) {
        for (int k = 0; k < 3; k++) {
            const int i = (k + 1) % 3, j = (k + 2) % 3;
            const double along = q[1] * v[0] + q[2] * v[1] + q[3] * v[2];
            out[k] = (2 * q[0] * q[0] - 1) * v[k] + 2 * along * q[k + 1] - 2 * q[0] * (q[i + 1] * v[j] - q[j + 1] * v[i]);
        }
    }
};

}  // namespace LAMMPS_NS
