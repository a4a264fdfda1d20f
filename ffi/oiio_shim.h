/* C interface to the part of OpenImageIO that twopass uses.
 *
 * No C++ exception leaves these functions. A function that fails returns NULL (or non-zero) and
 * writes a terminated message into the caller's `error` buffer of `error_size` bytes. Images are
 * encoded to memory: what reaches the disk, and every I/O error, is the caller's business. */
#ifndef TWOPASS_OIIO_SHIM_H
#define TWOPASS_OIIO_SHIM_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A text attribute of an image file. */
typedef struct TwopassAttribute {
    const char *name;
    const char *value;
} TwopassAttribute;

/* What to encode. `pixels` holds width * height * channels samples, top row first: uint8_t holding
 * sRGB where `eight_bit`, linear float otherwise. The file has the same sample type. */
typedef struct TwopassEncode {
    const char *format; /* an OpenImageIO plugin: "openexr", "tiff", "hdr", "png", "jpeg" */
    int width;
    int height;
    int channels;
    int eight_bit;
    const void *pixels;
    const char *compression; /* OpenImageIO's "compression" attribute, or NULL for the default */
    const TwopassAttribute *attributes;
    size_t attribute_count;
} TwopassEncode;

typedef struct TwopassBytes TwopassBytes;

/* Encodes an image file; free the result with twopass_bytes_free. */
TwopassBytes *twopass_encode(const TwopassEncode *what, char *error, size_t error_size);
const uint8_t *twopass_bytes_data(const TwopassBytes *bytes);
size_t twopass_bytes_size(const TwopassBytes *bytes);
void twopass_bytes_free(TwopassBytes *bytes);

typedef struct TwopassReader TwopassReader;

/* The first image of an open file; `srgb` is non-zero where samples are sRGB-encoded, `rgbe` where pixels share an exponent
   (Radiance's format). */
typedef struct TwopassHeader {
    int width;
    int height;
    int channels;
    int srgb;
    int rgbe;
} TwopassHeader;

/* Opens an image file and reads its header; free the result with twopass_reader_free. */
TwopassReader *twopass_reader_open(const char *path, TwopassHeader *header, char *error, size_t error_size);
/* Reads width * height * channels floats, top row first. */
int twopass_reader_read(TwopassReader *reader, float *pixels, char *error, size_t error_size);
void twopass_reader_free(TwopassReader *reader);

/* Writes the version of the OpenImageIO that runs, such as "2.4.7.1". */
void twopass_oiio_version(char *version, size_t size);

#ifdef __cplusplus
}
#endif

#endif
