#include "oiio_shim.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <cstdio>
#include <exception>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

struct TwopassBytes {
    std::vector<unsigned char> data;
};

struct TwopassReader {
    std::unique_ptr<OIIO::ImageInput> input;
    int channels;
};

namespace {

void copy_text(const std::string &text, char *out, size_t size) {
    if (out && size) std::snprintf(out, size, "%s", text.c_str());
}

/* OpenImageIO leaves the message empty now and then: say something all the same. */
[[noreturn]] void fail(const std::string &message) {
    throw std::runtime_error(message.empty() ? "OpenImageIO gives no reason" : message);
}

/* Runs `body`, turning whatever it throws into a message and `failed`. */
template <class Result, class Body>
Result guarded(Result failed, char *error, size_t error_size, Body body) noexcept {
    try {
        return body();
    } catch (const std::exception &e) {
        try {
            copy_text(e.what(), error, error_size);
        } catch (...) {
            if (error && error_size) error[0] = 0;
        }
    } catch (...) {
        if (error && error_size) std::snprintf(error, error_size, "unknown C++ exception");
    }
    return failed;
}

/* The names that OpenImageIO 2 and 3 give to sRGB: "sRGB", "srgb_rec709_scene". */
bool is_srgb(const std::string &colour_space) {
    return OIIO::Strutil::istarts_with(colour_space, "srgb");
}

}  // namespace

TwopassBytes *twopass_encode(const TwopassEncode *what, char *error, size_t error_size) {
    return guarded<TwopassBytes *>(nullptr, error, error_size, [&]() -> TwopassBytes * {
        /* Declared in this order because the writer, when destroyed, may still write to the proxy. */
        auto bytes = std::make_unique<TwopassBytes>();
        OIIO::Filesystem::IOVecOutput proxy(bytes->data);
        auto output = OIIO::ImageOutput::create(what->format);
        if (!output) fail(OIIO::geterror());
        if (!output->supports("ioproxy")) fail(std::string(what->format) + ": cannot be encoded to memory");

        const OIIO::TypeDesc type = what->eight_bit ? OIIO::TypeDesc::UINT8 : OIIO::TypeDesc::FLOAT;
        OIIO::ImageSpec spec(what->width, what->height, what->channels, type);
        spec.attribute("oiio:ColorSpace", what->eight_bit ? "sRGB" : "Linear");
        if (what->compression) spec.attribute("compression", what->compression);
        for (size_t i = 0; i < what->attribute_count; ++i)
            spec.attribute(what->attributes[i].name, what->attributes[i].value);

        output->set_ioproxy(&proxy);
        /* The extension only has to be one that the plugin accepts: nothing of this name is made. */
        if (!output->open(std::string("memory.") + what->format, spec)) fail(output->geterror());
        if (!output->write_image(type, what->pixels)) fail(output->geterror());
        if (!output->close()) fail(output->geterror());
        return bytes.release();
    });
}

const uint8_t *twopass_bytes_data(const TwopassBytes *bytes) { return bytes->data.data(); }

size_t twopass_bytes_size(const TwopassBytes *bytes) { return bytes->data.size(); }

void twopass_bytes_free(TwopassBytes *bytes) { delete bytes; }

TwopassReader *twopass_reader_open(const char *path, TwopassHeader *header, char *error, size_t error_size) {
    return guarded<TwopassReader *>(nullptr, error, error_size, [&]() -> TwopassReader * {
        auto reader = std::make_unique<TwopassReader>();
        /* Colours stay as the file has them: alpha is left out, and would have darkened them. */
        OIIO::ImageSpec config;
        config.attribute("oiio:UnassociatedAlpha", 1);
        reader->input = OIIO::ImageInput::open(path, &config);
        if (!reader->input) fail(OIIO::geterror());
        const OIIO::ImageSpec &spec = reader->input->spec();
        if (spec.depth > 1 || spec.deep) fail("volumes and deep images cannot be used");
        reader->channels = spec.nchannels;
        header->width = spec.width;
        header->height = spec.height;
        header->channels = spec.nchannels;
        header->srgb = is_srgb(spec.get_string_attribute("oiio:ColorSpace"));
        header->rgbe = std::string(reader->input->format_name()) == "hdr";
        return reader.release();
    });
}

int twopass_reader_read(TwopassReader *reader, float *pixels, char *error, size_t error_size) {
    return guarded<int>(1, error, error_size, [&]() -> int {
        if (!reader->input->read_image(0, 0, 0, reader->channels, OIIO::TypeDesc::FLOAT, pixels))
            fail(reader->input->geterror());
        return 0;
    });
}

void twopass_reader_free(TwopassReader *reader) {
    char ignored[1];
    guarded<int>(1, ignored, sizeof ignored, [&]() -> int {
        delete reader;
        return 0;
    });
}

void twopass_oiio_version(char *version, size_t size) {
    const int v = OIIO::openimageio_version();
    if (version && size)
        std::snprintf(version, size, "%d.%d.%d", v / 10000, v / 100 % 100, v % 100);
}
