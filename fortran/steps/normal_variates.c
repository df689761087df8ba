/* Normal variates as a function of four numbers, by Philox-4x64 with ten rounds: J. K. Salmon,
   M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC11 (2011).
   Fortran has neither unsigned integers nor products of 128 bits. */
#include <math.h>
#include <stdint.h>

__extension__ typedef unsigned __int128 wide;

static uint64_t high(uint64_t a, uint64_t b) { return (uint64_t)(((wide)a * b) >> 64); }

/* Writes four variates, for a key of two numbers and a counter of two, by Box and Muller. */
void normal_variates(const uint64_t key[2], const uint64_t counter[2], double x[4])
{
    const uint64_t a = 0xD2E7470EE14C6C93, b = 0xCA5A826395121157;
    uint64_t c[4] = {counter[0], counter[1], 0, 0}, k[2] = {key[0], key[1]};
    for (int round = 0; round < 10; round++) {
        uint64_t next[4] = {high(b, c[2]) ^ c[1] ^ k[0], b * c[2],
                            high(a, c[0]) ^ c[3] ^ k[1], a * c[0]};
        for (int i = 0; i < 4; i++) c[i] = next[i];
        k[0] += 0x9E3779B97F4A7C15;
        k[1] += 0xBB67AE8584CAA73B;
    }
    for (int i = 0; i < 4; i += 2) {
        double uniform = ((double)(c[i] >> 11) + 0.5) * 0x1p-53;
        double angle = (double)(c[i + 1] >> 11) * (0x1p-53 * 6.283185307179586);
        double radius = sqrt(-2.0 * log(uniform));
        x[i] = radius * cos(angle);
        x[i + 1] = radius * sin(angle);
    }
}
