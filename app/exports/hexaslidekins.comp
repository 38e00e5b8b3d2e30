// SPDX-License-Identifier: GPL-2.0-or-later
//
// Kinematics of a Hexa Slide as glidecal calibrates it: six carriages on rails, six links of fixed
// length, a platform that turns. A module of kinematics is linked with LinuxCNC, so this file alone
// has LinuxCNC's licence.
//
// |tool + R joint_i - start_i - rail_i q_i| = link_i, the carriage behind the platform on its rail;
// R = Ry(b) Rx(a) Rz(c), degrees. Lengths in machine units.
component hexaslidekins "Kinematics of a Hexa Slide, with its calibration";
description """
Install with 'halcompile --install hexaslidekins.comp', name it in [KINS] with JOINTS = 6 and load
the values with HALFILE = calib.hal, after the file that loads the kinematics. COORDINATES = XYZABC.
""";
option singleton yes;
option period no;
pin in float start-#-x[6] "where joint 0 of the carriage is";
pin in float start-#-y[6];
pin in float start-#-z[6];
pin in float rail-#-x[6] "unit vector";
pin in float rail-#-y[6];
pin in float rail-#-z[6];
pin in float joint-#-x[6] "on the platform";
pin in float joint-#-y[6];
pin in float joint-#-z[6];
pin in float link-#[6];
pin in float centre-#[6] "x, y, z, a, b, c of a posture on the branch of the machine";
license "GPL";
author "glidecal";
;;

#include <rtapi_math.h>
#include <kinematics.h>

KINS_NOT_SWITCHABLE
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsInverse);
EXPORT_SYMBOL(kinematicsForward);

#define STEPS 40
#define PARTS 16
#define NEAR 0.01 // of a link: so far a joint may move between two calls, or the way is followed
#define RAD (3.14159265358979323846 / 180)

// pins are reached through the instance
#define INSTANCE struct __comp_state *__comp_inst = __comp_first_inst

typedef struct { double r[3][3], axes[3][3]; } turn; // axes about which a, b, c turn

static turn turned(const double p[6]) {
    double sa = sin(p[3]), ca = cos(p[3]), sb = sin(p[4]), cb = cos(p[4]), sc = sin(p[5]), cc = cos(p[5]);
    turn t = {{{cb*cc + sb*sa*sc, -cb*sc + sb*sa*cc, sb*ca},
               {ca*sc, ca*cc, -sa},
               {-sb*cc + cb*sa*sc, sb*sc + cb*sa*cc, cb*ca}},
              {{cb, 0, -sb}, {0, 1, 0}, {sb*ca, -sa, cb*ca}}};
    return t;
}

// arm to the joint and from the start of the rail to it
static void reach(const double p[6], const turn *t, int i, double arm[3], double to[3]) {
    INSTANCE;
    double b[3] = {joint_x(i), joint_y(i), joint_z(i)}, s[3] = {start_x(i), start_y(i), start_z(i)};
    int k;
    for (k = 0; k < 3; k++) {
        arm[k] = t->r[k][0]*b[0] + t->r[k][1]*b[1] + t->r[k][2]*b[2];
        to[k] = p[k] + arm[k] - s[k];
    }
}

static int slider(const double p[6], const turn *t, int i, double *q) {
    INSTANCE;
    double arm[3], to[3], along, root;
    reach(p, t, i, arm, to);
    along = to[0]*rail_x(i) + to[1]*rail_y(i) + to[2]*rail_z(i);
    root = link(i)*link(i) - (to[0]*to[0] + to[1]*to[1] + to[2]*to[2]) + along*along;
    if (!(root >= 0)) return -1;
    *q = along - sqrt(root);
    return 0;
}

// Gauss with exchange of rows; the last column becomes the solution
static int solve(double m[6][7]) {
    int i, j, k;
    for (k = 0; k < 6; k++) {
        int top = k;
        for (i = k + 1; i < 6; i++) if (fabs(m[i][k]) > fabs(m[top][k])) top = i;
        if (!(fabs(m[top][k]) > 1e-12)) return -1;
        for (j = 0; j < 7; j++) { double held = m[k][j]; m[k][j] = m[top][j]; m[top][j] = held; }
        for (i = 0; i < 6; i++) {
            double share = m[i][k] / m[k][k];
            if (i != k) for (j = k; j < 7; j++) m[i][j] -= share * m[k][j];
        }
    }
    for (k = 0; k < 6; k++) m[k][6] /= m[k][k];
    return 0;
}

// Newton's method from p
static int stand(const double *q, double p[6]) {
    INSTANCE;
    double m[6][7], size;
    int i, k, step;
    for (step = 0; step < STEPS; step++) {
        turn t = turned(p);
        for (i = 0; i < 6; i++) {
            double arm[3], l[3], over[3];
            reach(p, &t, i, arm, l);
            l[0] -= q[i] * rail_x(i); l[1] -= q[i] * rail_y(i); l[2] -= q[i] * rail_z(i);
            over[0] = arm[1]*l[2] - arm[2]*l[1];
            over[1] = arm[2]*l[0] - arm[0]*l[2];
            over[2] = arm[0]*l[1] - arm[1]*l[0];
            for (k = 0; k < 3; k++) {
                m[i][k] = l[k];
                m[i][3 + k] = over[0]*t.axes[k][0] + over[1]*t.axes[k][1] + over[2]*t.axes[k][2];
            }
            m[i][6] = (link(i)*link(i) - l[0]*l[0] - l[1]*l[1] - l[2]*l[2]) / 2;
        }
        if (solve(m)) return -1;
        for (k = 0, size = 0; k < 6; k++) {
            p[k] += m[k][6];
            if (fabs(m[k][6]) > size) size = fabs(m[k][6]);
        }
        if (!(size < 1e6)) return -1;
        if (size < 1e-10) {
            turn at = turned(p);
            double own;
            for (i = 0; i < 6; i++) // on the branch, the carriage behind the platform
                if (slider(p, &at, i, &own) || fabs(own - q[i]) > 1e-6) return -1;
            return 0;
        }
    }
    return -1;
}

KINEMATICS_TYPE kinematicsType() { return KINEMATICS_BOTH; }

int kinematicsForward(const double *joints, EmcPose *pos,
                      const KINEMATICS_FORWARD_FLAGS *fflags, KINEMATICS_INVERSE_FLAGS *iflags) {
    INSTANCE;
    static double last[6], at[6]; // a posture, and its joints
    static int begun = 0;
    double p[6], centre_p[6], middle[6], on_way[6];
    int i, share, near = begun;
    (void)fflags; (void)iflags;
    for (i = 0; i < 6; i++) {
        if (!(fabs(joints[i] - at[i]) < NEAR * link(i))) near = 0;
        p[i] = last[i];
        centre_p[i] = centre(i) * (i < 3 ? 1 : RAD);
    }
    if (!near || stand(joints, p)) { // followed from the centre, so that it stays on the branch
        turn t = turned(centre_p);
        for (i = 0; i < 6; i++) {
            if (slider(centre_p, &t, i, &middle[i])) return -1;
            p[i] = centre_p[i];
        }
        for (share = 1; share <= PARTS; share++) {
            for (i = 0; i < 6; i++) on_way[i] = middle[i] + (joints[i] - middle[i]) * share / PARTS;
            if (stand(on_way, p)) return -1;
        }
    }
    for (i = 0; i < 6; i++) {
        last[i] = p[i];
        at[i] = joints[i];
    }
    begun = 1;
    pos->tran.x = p[0];
    pos->tran.y = p[1];
    pos->tran.z = p[2];
    pos->a = p[3] / RAD;
    pos->b = p[4] / RAD;
    pos->c = p[5] / RAD;
    pos->u = pos->v = pos->w = 0;
    return 0;
}

int kinematicsInverse(const EmcPose *pos, double *joints,
                      const KINEMATICS_INVERSE_FLAGS *iflags, KINEMATICS_FORWARD_FLAGS *fflags) {
    double p[6] = {pos->tran.x, pos->tran.y, pos->tran.z, pos->a * RAD, pos->b * RAD, pos->c * RAD};
    turn t = turned(p);
    int i;
    (void)iflags; (void)fflags;
    for (i = 0; i < 6; i++) if (slider(p, &t, i, &joints[i])) return -1;
    return 0;
}
