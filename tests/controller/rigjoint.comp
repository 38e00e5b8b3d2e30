// One joint of a simulated machine: what a carriage does that a motor pushes. No code of glidecal.
component rigjoint "A carriage with mounting constant, screw error, play and a home switch";
option period no;
pin in float motor;
pin out float motor_fb;
pin out float carriage;
pin out bit home_sw;
pin out s32 still "periods since the motor moved last";
param rw float mounting = 0 "carriage less motor where nothing else is off, mm";
param rw float way = 1 "-1: the motor counts against the carriage";
param rw float scale = 0 "mm per mm from zero";
param rw float zero = 0 "carriage coordinate where scale and cyclic error vanish";
param rw float cyclic = 0 "amplitude of a sine, mm";
param rw float lead = 5;
param rw float play = 0 "the carriage stays so much higher when it comes down, mm";
param rw float switch_at = 0 "carriage coordinate from which the switch is closed";
param rw bit stuck = 0 "nothing follows the motor";
variable int moved = 0;
variable double place = 0;
variable double last = 0;
function _;
license "GPL";
;;
#include <rtapi_math.h>
FUNCTION(_) {
    if (stuck) return;
    double x = way * motor + mounting;
    double pushed = x + scale * (x - zero) + cyclic * sin(2 * M_PI * (x - zero) / lead);
    if (!moved || pushed > place) place = pushed;
    else if (pushed + play < place) place = pushed + play;
    moved = 1;
    if (fabs(motor - last) > 1e-9) still = 0;
    else if (still < 1000) still = still + 1;
    last = motor;
    carriage = place;
    motor_fb = motor;
    home_sw = place >= switch_at;
}
