/* A drawer under a hand, integrated in C: nothing of it is shared with the simulator in Rust or with the library of effects, so that
 * what the identification names is checked by somebody else's formulas.
 *
 * Usage: joint EFFECTS SEED > table.csv        columns t (s), q (m), f (N on the drawer) at 500 Hz for a minute
 *
 * EFFECTS are joined by plus signs, or `none`. The object and the sizes are those of SEED / 2, the hand and the noise of SEED: two seeds
 * are two recordings of one drawer. Its mass, Coulomb and viscous friction go to standard error. Steps of 50 us; a joint whose speed would change its sign stops, and stays while what acts on it is
 * below the breakaway. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STEP 5e-5
#define RANGE 0.4
#define EVERY 40
#define SECONDS 60.0
#define PI 3.14159265358979

static unsigned long long state;

/* Uniform in [0, 1): xorshift. */
static double any(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) / 9007199254740992.0;
}

static double between(double least, double most) { return least + (most - least) * any(); }

static double normal(void) { return sqrt(-2.0 * log(any() + 1e-300)) * cos(2.0 * PI * any()); }

static void seed(unsigned long long value)
{
    state = 88172645463325252ULL ^ (value + 1) * 0x9e3779b97f4a7c15ULL;
    for (int i = 0; i < 64; i++)
        any();
}

static double sign(double x) { return (x > 0.0) - (x < 0.0); }

/* Of the drawer; 0 where it has no such thing. */
struct drawer {
    double mass, coulomb, viscous;
    double spring, load, hardening;                   /* N/m, N, N/m^3 */
    double stribeck, stribeck_speed;                  /* N, m/s */
    double bristle;                                   /* stiffness of LuGre's bristles, N/m */
    double notch, notch_at, notch_reach;              /* N, m, m */
    double magnet, magnet_reach;                      /* N, m */
    double roller, roller_period;                     /* N, m */
    double drag;                                      /* N s^2/m^2 */
    double closing_damper;                            /* N s/m, one way */
    double rough;                                     /* N of friction gained over the range */
    double warm, warm_s;                              /* N of friction lost with time */
    double root;                                      /* N per root of a speed: in no library */
    double brake;                                     /* N of friction between two places: in no library */
    double bumper;                                    /* N/m of rubber from 85 % of the range on: in no library */
    double liquid;                                    /* kg that sloshes at 1.5 Hz: in no library */
    double relaxing;                                  /* N s/m of a damper behind a spring: in no library */
};

static struct drawer drawn(const char *effects)
{
    struct drawer d = {between(1.5, 9.0), between(2.0, 7.0), between(2.0, 8.0), .stribeck_speed = between(0.02, 0.07)};
    double sizes[12];
    for (int i = 0; i < 12; i++)
        sizes[i] = any();
#define HAS(name) (strstr(effects, name) != NULL)
#define SIZE(i, least, most) ((least) + ((most) - (least)) * sizes[i])
    if (HAS("spring"))
        d.spring = SIZE(0, 8.0, 30.0);
    if (HAS("constant_load"))
        d.load = -SIZE(1, 1.2, 4.0);
    if (HAS("hardening"))
        d.hardening = SIZE(2, 80.0, 200.0);
    if (HAS("stribeck"))
        d.stribeck = d.coulomb * SIZE(3, 0.4, 1.0);
    if (HAS("presliding"))
        d.bristle = d.coulomb / SIZE(4, 0.5e-3, 1.5e-3);
    if (HAS("detent"))
        d.notch = SIZE(5, 4.0, 9.0), d.notch_at = SIZE(6, 0.12, 0.28), d.notch_reach = SIZE(7, 0.015, 0.03);
    if (HAS("catch"))
        d.magnet = SIZE(5, 8.0, 25.0), d.magnet_reach = SIZE(7, 0.015, 0.035);
    if (HAS("ripple"))
        d.roller = SIZE(5, 0.6, 2.0), d.roller_period = SIZE(6, 0.04, 0.12);
    if (HAS("quadratic_drag"))
        d.drag = SIZE(8, 5.0, 14.0);
    if (HAS("asymmetric_viscous"))
        d.closing_damper = SIZE(8, 5.0, 14.0);
    if (HAS("position_dependent_friction"))
        d.rough = d.coulomb * SIZE(9, 0.5, 1.4);
    if (HAS("friction_drift"))
        d.warm = d.coulomb * SIZE(10, 0.3, 0.9), d.warm_s = SIZE(11, 15.0, 45.0);
    if (HAS("root"))
        d.root = SIZE(8, 3.0, 9.0);
    if (HAS("brake"))
        d.brake = SIZE(9, 1.5, 4.0);
    if (HAS("bumper"))
        d.bumper = SIZE(0, 300.0, 1500.0);
    if (HAS("liquid"))
        d.liquid = d.mass * SIZE(0, 0.15, 0.5);
    if (HAS("relaxing"))
        d.relaxing = SIZE(0, 10.0, 40.0);
    return d;
}

static double load(const struct drawer *d, double q)
{
    double from_notch = d->notch_reach > 0.0 ? (q - d->notch_at) / d->notch_reach : 1.0;
    double sum = d->spring * (q - 0.04) + d->load + d->hardening * pow(q - 0.12, 3.0);
    if (fabs(from_notch) < 1.0)
        sum += d->notch * sin(PI * from_notch);
    if (d->magnet > 0.0)
        sum += d->magnet / pow(1.0 + fmax(q, 0.0) / d->magnet_reach, 2.0);
    if (d->roller > 0.0)
        sum += d->roller * cos(2.0 * PI * q / d->roller_period + 1.0);
    return sum + d->bumper * fmax(q - 0.85 * RANGE, 0.0);
}

static double damping(const struct drawer *d, double dq)
{
    double sum = d->viscous * dq + d->drag * dq * fabs(dq) + d->root * sign(dq) * sqrt(fabs(dq));
    return dq < 0.0 ? sum + d->closing_damper * dq : sum;
}

/* Dry friction that slides, but for its sign and for what Stribeck's curve adds. */
static double dry(const struct drawer *d, double q, double t)
{
    double sum = d->coulomb + d->rough * fmin(fmax(q / RANGE, 0.0), 1.0);
    if (d->warm > 0.0)
        sum += d->warm * exp(-t / d->warm_s);
    if (d->brake > 0.0 && q > 0.55 * RANGE && q < 0.7 * RANGE)
        sum += d->brake;
    return sum;
}

/* One stroke of the hand: a minimum-jerk way from one place to another. */
struct stroke {
    double from, to, start, end;
};

static struct stroke next_stroke(struct stroke last)
{
    struct stroke s = {last.to, last.to, last.end, last.end + between(0.2, 0.8)};
    if (any() < 0.15)
        return s;
    if (any() < 0.4)
        s.to = RANGE * (last.to > 0.5 * RANGE ? between(0.01, 0.11) : between(0.85, 0.97));
    else
        s.to = RANGE * between(0.02, 0.97);
    double speed = any() < 0.3 ? between(0.03, 0.1) : between(0.15, 1.2);
    s.end = s.start + fmax(0.25, 1.5 * fabs(s.to - s.from) / speed);
    return s;
}

int main(int count, char **arguments)
{
    if (count != 3) {
        fprintf(stderr, "usage: joint EFFECTS SEED\n");
        return 2;
    }
    unsigned long long number = strtoull(arguments[2], NULL, 10);
    seed(1000 + number / 2);
    struct drawer d = drawn(arguments[1]);
    fprintf(stderr, "%.9g %.9g %.9g\n", d.mass, d.coulomb, d.viscous);
    seed(number);
    double stiffness = 900.0 * d.mass, hand_damping = 54.0 * d.mass;
    double q = 0.02 * RANGE, dq = 0.0, bristle = 0.0, tremor = 0.0;
    double liquid_at = q, liquid_speed = 0.0, piston = q;
    struct stroke s = {q, q, 0.0, 0.5};
    printf("t,q,f\n");
    for (long i = 0; i * STEP < SECONDS; i++) {
        double t = i * STEP;
        if (t > s.end)
            s = next_stroke(s);
        double x = (t - s.start) / (s.end - s.start), way = s.to - s.from;
        double wanted = s.from + way * x * x * x * (10.0 + x * (6.0 * x - 15.0));
        double wanted_speed = way / (s.end - s.start) * 30.0 * x * x * (1.0 - x) * (1.0 - x);
        tremor += -8.0 * tremor * STEP + 2.0 * sqrt(STEP) * normal();
        double hand = stiffness * (wanted - q) + hand_damping * (wanted_speed - dq) + tremor;
        if (i % EVERY == 0)
            printf("%.4f,%.7f,%.5f\n", t, q + 1e-4 * normal(), hand + 0.1 * normal());
        double rest = hand - load(&d, q) - damping(&d, dq), slides = dry(&d, q, t);
        if (d.liquid > 0.0) {
            double rate = 2.0 * PI * 1.5, held = d.liquid * rate * (rate * (liquid_at - q) + 0.2 * (liquid_speed - dq));
            liquid_speed -= STEP * held / d.liquid;
            liquid_at += STEP * liquid_speed;
            rest += held;
        }
        if (d.relaxing > 0.0) {
            double held = d.relaxing / 0.15 * (q - piston);
            piston += STEP * held / d.relaxing;
            rest -= held;
        }
        double resists = slides + d.stribeck * exp(-pow(dq / d.stribeck_speed, 2.0));
        if (d.bristle > 0.0) {
            double rate = dq - d.bristle * fabs(dq) / resists * bristle;
            double inner = 0.3 * sqrt(d.bristle * d.mass) * exp(-pow(dq / 0.02, 2.0));
            bristle += STEP * rate;
            dq += STEP * (rest - d.bristle * bristle - inner * rate) / d.mass;
        } else if (dq != 0.0 || fabs(rest) > slides + d.stribeck) {
            double way_of = dq != 0.0 ? sign(dq) : sign(rest);
            double faster = dq + STEP * (rest - way_of * resists) / d.mass;
            dq = dq != 0.0 && sign(faster) != sign(dq) ? 0.0 : faster;
        }
        q += STEP * dq;
    }
    return 0;
}
