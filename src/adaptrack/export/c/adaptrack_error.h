/* adaptrack: what every function answers. */
#ifndef ADAPTRACK_ERROR_H
#define ADAPTRACK_ERROR_H

/* Values stay; a minor version may add some. */
typedef enum {
    ADAPTRACK_OK = 0,
    ADAPTRACK_BAD_ARGUMENT = 1,    /* a null pointer, a size, an address that is no multiple of 8 */
    ADAPTRACK_TOO_SMALL = 2,       /* the memory */
    ADAPTRACK_NOT_READY = 3,       /* the memory has not been initialised, or was overwritten */
    ADAPTRACK_BUSY = 4,            /* another thread, or an interrupted call, is in a step of this memory */
    ADAPTRACK_DAMAGED = 5,         /* the block or the saved state is cut short, or a byte of it is another */
    ADAPTRACK_OTHER_VERSION = 6,   /* the format, or the kernels, are of another version of adaptrack */
    ADAPTRACK_OTHER_KIND = 7,      /* constants of another kind of controller, or of functions not linked in */
    ADAPTRACK_OTHER_SIZES = 8,     /* constants of other horizons or parts: adaptrack_init takes them */
    ADAPTRACK_OTHER_CONSTANTS = 9, /* the state was saved under other constants */
    ADAPTRACK_OTHER_PATH = 10,     /* the state was saved on another path */
    ADAPTRACK_ARITHMETIC = 11,     /* rounding is not to nearest, or subnormal numbers count as zero */
    ADAPTRACK_BAD_PATH = 12,       /* the points make no path, or the memory holds none */
    ADAPTRACK_OUT_OF_ORDER = 13    /* a call that has to wait for another one first */
} adaptrack_error;

#endif
