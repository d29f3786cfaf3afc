#include "kernels.h"

/* Fingerprint of the sources that this library was made of, given by the build. */
EXPORT uint32_t syncline_fingerprint(void) { return SYNCLINE_FINGERPRINT; }
