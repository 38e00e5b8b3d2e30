// SPDX-License-Identifier: GPL-2.0-or-later
//
// Kinematics of three linear drives, three bars and a platform that never turns, as glidecal
// calibrates them: the Orthoglide and the linear delta are two sets of pins. A module of
// kinematics is linked with LinuxCNC, so this file alone has LinuxCNC's licence.
//
// Foot of bar i for coordinate q of its drive:  origin + direction q + bend (q - zero)^2
// (direction of any length: it holds the scale, the lean and the squareness of the drive).
// |tool + platform - foot| = length + sag * pull, with the pull of weight in the bar from the
// equilibrium of the unloaded platform. Lengths in machine units.
component orthoglidekins "Kinematics of an Orthoglide or a linear delta, with its calibration";
description """
Install with 'halcompile --install orthoglidekins.comp', name it in [KINS] and load the values with
HALFILE = calib.hal, after the file that loads the kinematics.
""";
option singleton yes;
option period no;
pin in float origin-#-x[3];
pin in float origin-#-y[3];
pin in float origin-#-z[3];
pin in float direction-#-x[3];
pin in float direction-#-y[3];
pin in float direction-#-z[3];
pin in float bend-#-x[3] "per machine unit";
pin in float bend-#-y[3];
pin in float bend-#-z[3];
pin in float zero-#[3] "coordinate of the drive from which the bend counts";
pin in float platform-#-x[3];
pin in float platform-#-y[3];
pin in float platform-#-z[3];
pin in float length-#[3];
pin in float sag-#[3] "a bar pressed with the weight gets so much shorter";
pin in float gravity-x;
pin in float gravity-y;
pin in float gravity-z = -1;
pin in float joint-#[3] = -1 "the joint that moves this drive; -1: that of its number";
pin in float way-#[3] = 1 "-1: the joint counts against the drive";
pin in float side = 1 "of the plane of the feet on which the tool is: 1 or -1";
license "GPL";
author "glidecal";
;;

#include <rtapi_math.h>
#include <kinematics.h>

KINS_NOT_SWITCHABLE
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsInverse);
EXPORT_SYMBOL(kinematicsForward);

#define PASSES 4 // sag and bend are small: each pass leaves a thousandth of the error

typedef struct { double v[3]; } vec;

static vec minus(vec a, vec b) { vec r = {{a.v[0]-b.v[0], a.v[1]-b.v[1], a.v[2]-b.v[2]}}; return r; }
static vec plus(vec a, double k, vec b) { vec r = {{a.v[0]+k*b.v[0], a.v[1]+k*b.v[1], a.v[2]+k*b.v[2]}}; return r; }
static double dot(vec a, vec b) { return a.v[0]*b.v[0] + a.v[1]*b.v[1] + a.v[2]*b.v[2]; }
static vec cross(vec a, vec b) {
    vec r = {{a.v[1]*b.v[2]-a.v[2]*b.v[1], a.v[2]*b.v[0]-a.v[0]*b.v[2], a.v[0]*b.v[1]-a.v[1]*b.v[0]}};
    return r;
}

// pins are reached through the instance
#define INSTANCE struct __comp_state *__comp_inst = __comp_first_inst

static vec origin_of(int i) { INSTANCE; vec r = {{origin_x(i), origin_y(i), origin_z(i)}}; return r; }
static vec direction_of(int i) { INSTANCE; vec r = {{direction_x(i), direction_y(i), direction_z(i)}}; return r; }
static vec bend_of(int i) { INSTANCE; vec r = {{bend_x(i), bend_y(i), bend_z(i)}}; return r; }
static vec platform_of(int i) { INSTANCE; vec r = {{platform_x(i), platform_y(i), platform_z(i)}}; return r; }
static vec gravity_of(void) { INSTANCE; vec r = {{gravity_x, gravity_y, gravity_z}}; return r; }
static double length_of(int i) { INSTANCE; return length(i); }
static double sag_of(int i) { INSTANCE; return sag(i); }
static double zero_of(int i) { INSTANCE; return zero(i); }
static double way_of(int i) { INSTANCE; return way(i); }
static int joint_of(int i) { INSTANCE; int n = (int)joint(i); return n < 0 || n > 2 ? i : n; }
static double side_of(void) { INSTANCE; return side; }

static vec foot(int i, double q) {
    double t = q - zero_of(i);
    return plus(plus(origin_of(i), q, direction_of(i)), t * t, bend_of(i));
}

// where three spheres about the feet (less the platform) meet; -1 where they do not
static int meet(const vec at[3], const double l[3], vec *tool) {
    vec a = minus(at[1], at[0]), b = minus(at[2], at[0]), n = cross(a, b);
    double nn = dot(n, n), u, w, h;
    vec p;
    if (!(nn > 1e-9)) return -1;
    u = (dot(a, a) + l[0]*l[0] - l[1]*l[1]) / 2;
    w = (dot(b, b) + l[0]*l[0] - l[2]*l[2]) / 2;
    p = plus(plus(at[0], u / nn, cross(b, n)), w / nn, cross(n, a));
    h = l[0]*l[0] - dot(minus(p, at[0]), minus(p, at[0]));
    if (!(h >= 0)) return -1;
    *tool = plus(p, side_of() * sqrt(h / nn), n);
    return 0;
}

// lengths of the bars under weight, for feet less the platform
static int loaded(const vec at[3], double l[3]) {
    vec bar[3], tool, g = gravity_of();
    double volume;
    int i;
    for (i = 0; i < 3; i++) l[i] = length_of(i);
    if (sag_of(0) == 0 && sag_of(1) == 0 && sag_of(2) == 0) return 0;
    if (meet(at, l, &tool)) return -1;
    for (i = 0; i < 3; i++) bar[i] = plus(minus(tool, at[i]), 0, g);
    volume = dot(bar[0], cross(bar[1], bar[2]));
    if (!(fabs(volume) > 1e-9)) return -1;
    for (i = 0; i < 3; i++) // Cramer's rule for sum pull_i bar_i / l_i = g
        l[i] += sag_of(i) * l[i] * dot(g, cross(bar[(i+1)%3], bar[(i+2)%3])) / volume;
    return 0;
}

KINEMATICS_TYPE kinematicsType() { return KINEMATICS_BOTH; }

int kinematicsForward(const double *joints, EmcPose *pos,
                      const KINEMATICS_FORWARD_FLAGS *fflags, KINEMATICS_INVERSE_FLAGS *iflags) {
    vec at[3], tool;
    double l[3];
    int i;
    (void)fflags; (void)iflags;
    for (i = 0; i < 3; i++) at[i] = minus(foot(i, way_of(i) * joints[joint_of(i)]), platform_of(i));
    if (loaded(at, l) || meet(at, l, &tool)) return -1;
    pos->tran.x = tool.v[0];
    pos->tran.y = tool.v[1];
    pos->tran.z = tool.v[2];
    pos->a = pos->b = pos->c = pos->u = pos->v = pos->w = 0;
    return 0;
}

int kinematicsInverse(const EmcPose *pos, double *joints,
                      const KINEMATICS_INVERSE_FLAGS *iflags, KINEMATICS_FORWARD_FLAGS *fflags) {
    vec tool = {{pos->tran.x, pos->tran.y, pos->tran.z}}, at[3];
    double l[3], q[3];
    int i, pass;
    (void)iflags; (void)fflags;
    for (i = 0; i < 3; i++) {
        l[i] = length_of(i);
        q[i] = zero_of(i);
    }
    for (pass = 0; pass < PASSES; pass++) {
        for (i = 0; i < 3; i++) {
            vec d = direction_of(i), way = minus(plus(tool, 1, platform_of(i)), origin_of(i));
            double dd = dot(d, d), t = q[i] - zero_of(i), b, root;
            if (!(dd > 1e-9)) return -1;
            way = plus(way, -t * t, bend_of(i));
            b = dot(d, way);
            root = b * b - dd * (dot(way, way) - l[i] * l[i]);
            if (!(root >= 0)) return -1;
            q[i] = (b + sqrt(root)) / dd; // the carriage is ahead of the platform
        }
        for (i = 0; i < 3; i++) at[i] = minus(foot(i, q[i]), platform_of(i));
        if (loaded(at, l)) return -1;
    }
    for (i = 0; i < 3; i++) joints[joint_of(i)] = way_of(i) * q[i];
    return 0;
}
