// Reads messages of cogradar with MessagePack's own header, and writes them back.
//
// Standard input is messages, each behind its length in four bytes, little-endian. For each a line of JSON goes to standard
// output, its content as docs/reference/wire.md has it, and "same" or "differs" before it: whether it was written back byte
// for byte. With the argument "count" only the numbers of messages, of those that differ, and of seconds are printed.

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

#include <msgpack.hpp>

using msgpack::object;

template <typename T>
T little(const char* data) {  // of a little-endian machine
    T value;
    std::memcpy(&value, data, sizeof value);
    return value;
}

std::string number(double value) {
    char text[40];
    std::snprintf(text, sizeof text, "%.17g", value);
    const bool is_float = std::strpbrk(text, ".en") != nullptr;
    return is_float ? text : std::string(text) + ".0";
}

std::string quoted(const char* data, std::size_t n) {
    std::string text = "\"";
    for (std::size_t i = 0; i < n; ++i) {
        const unsigned char c = static_cast<unsigned char>(data[i]);
        if (c == '"' || c == '\\') text += '\\';
        if (c < 0x20) throw std::runtime_error("a control character");
        text += static_cast<char>(c);
    }
    return text + '"';
}

std::string base64(const unsigned char* data, std::size_t n) {
    static const char* const letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string text;
    for (std::size_t i = 0; i < n; i += 3) {
        std::uint32_t three = data[i] << 16;
        if (i + 1 < n) three |= data[i + 1] << 8;
        if (i + 2 < n) three |= data[i + 2];
        text += letters[three >> 18];
        text += letters[three >> 12 & 63];
        text += i + 1 < n ? letters[three >> 6 & 63] : '=';
        text += i + 2 < n ? letters[three & 63] : '=';
    }
    return text;
}

// Kind, shape and elements of an array; complex numbers count twice.
struct Array {
    std::string dtype;
    std::vector<std::uint32_t> shape;
    std::vector<double> values;

    Array(std::int8_t type, const char* data, std::size_t n_byte) : dtype(data, 2) {
        if (type != 1) throw std::runtime_error("an extension value that is no array");
        const std::size_t n_axis = static_cast<unsigned char>(data[2]);
        std::size_t n = dtype == "c8" ? 2 : 1;
        for (std::size_t i = 0; i < n_axis; ++i) {
            shape.push_back(little<std::uint32_t>(data + 3 + 4 * i));
            n *= shape.back();
        }
        const char* at = data + 3 + 4 * n_axis;
        const std::size_t size = dtype == "f8" ? 8 : 4;
        if (at + n * size != data + n_byte) throw std::runtime_error("an array of another length");
        values.reserve(n);
        for (std::size_t i = 0; i < n; ++i, at += size)
            values.push_back(dtype == "f8" ? little<double>(at)
                             : dtype == "c8" ? static_cast<double>(little<float>(at))
                                             : static_cast<double>(little<std::int32_t>(at)));
    }
};

// Writes a value. A float stays a float: the library's own `pack` makes an integer of one that is whole.
void write(msgpack::sbuffer& out, const object& value) {
    msgpack::packer<msgpack::sbuffer> packer(out);
    if (value.type == msgpack::type::FLOAT64) {
        std::uint64_t bits = 0;
        std::memcpy(&bits, &value.via.f64, sizeof bits);
        char bytes[9] = {static_cast<char>(0xcb)};
        for (int i = 0; i < 8; ++i) bytes[1 + i] = static_cast<char>(bits >> (56 - 8 * i));
        out.write(bytes, sizeof bytes);
    } else if (value.type == msgpack::type::ARRAY) {
        packer.pack_array(value.via.array.size);
        for (std::uint32_t i = 0; i < value.via.array.size; ++i) write(out, value.via.array.ptr[i]);
    } else if (value.type == msgpack::type::MAP) {
        packer.pack_map(value.via.map.size);
        for (std::uint32_t i = 0; i < value.via.map.size; ++i) {
            write(out, value.via.map.ptr[i].key);
            write(out, value.via.map.ptr[i].val);
        }
    } else {
        packer.pack(value);
    }
}

std::string joined(const std::vector<std::string>& parts) {
    std::string text;
    for (const std::string& part : parts) text += (text.empty() ? "" : ", ") + part;
    return text;
}

std::string json(const object& value) {
    std::vector<std::string> parts;
    switch (value.type) {
        case msgpack::type::NIL: return "null";
        case msgpack::type::BOOLEAN: return value.via.boolean ? "true" : "false";
        case msgpack::type::POSITIVE_INTEGER: return std::to_string(value.via.u64);
        case msgpack::type::NEGATIVE_INTEGER: return std::to_string(value.via.i64);
        case msgpack::type::FLOAT64: return number(value.via.f64);
        case msgpack::type::STR: return quoted(value.via.str.ptr, value.via.str.size);
        case msgpack::type::BIN:
            return "{\"base64\": \"" + base64(reinterpret_cast<const unsigned char*>(value.via.bin.ptr), value.via.bin.size) +
                   "\"}";
        case msgpack::type::ARRAY:
            for (const object& part : value.as<std::vector<object>>()) parts.push_back(json(part));
            return "[" + joined(parts) + "]";
        case msgpack::type::MAP:
            for (std::uint32_t i = 0; i < value.via.map.size; ++i)
                parts.push_back(json(value.via.map.ptr[i].key) + ": " + json(value.via.map.ptr[i].val));
            return "{" + joined(parts) + "}";
        case msgpack::type::EXT: {
            const Array array(value.via.ext.type(), value.via.ext.data(), value.via.ext.size);
            std::vector<std::string> lengths;
            for (std::uint32_t length : array.shape) lengths.push_back(std::to_string(length));
            const bool is_whole = array.dtype == "i4";
            for (double one : array.values)
                parts.push_back(is_whole ? std::to_string(static_cast<std::int32_t>(one)) : number(one));
            return "{\"dtype\": \"" + array.dtype + "\", \"shape\": [" + joined(lengths) + "], \"values\": [" +
                   joined(parts) + "]}";
        }
        default: throw std::runtime_error("a kind that is never sent");
    }
}

// Reads every array of a value; how many numbers they have.
std::size_t numbers(const object& value) {
    std::size_t n = 0;
    if (value.type == msgpack::type::MAP)
        for (std::uint32_t i = 0; i < value.via.map.size; ++i) n += numbers(value.via.map.ptr[i].val);
    else if (value.type == msgpack::type::ARRAY)
        for (std::uint32_t i = 0; i < value.via.array.size; ++i) n += numbers(value.via.array.ptr[i]);
    else if (value.type == msgpack::type::EXT)
        n += Array(value.via.ext.type(), value.via.ext.data(), value.via.ext.size).values.size();
    return n;
}

int main(int argc, char** argv) {
    const bool only_counts = argc > 1 && std::string(argv[1]) == "count";
    std::ios::sync_with_stdio(false);
    const std::string input((std::istreambuf_iterator<char>(std::cin)), std::istreambuf_iterator<char>());
    std::size_t n = 0, n_different = 0, n_number = 0;
    const auto begun = std::chrono::steady_clock::now();
    for (std::size_t at = 0; at < input.size(); ++n) {
        const std::size_t size = little<std::uint32_t>(input.data() + at);
        const char* payload = input.data() + at + 4;
        at += 4 + size;
        const msgpack::object_handle handle = msgpack::unpack(payload, size);
        msgpack::sbuffer written;
        write(written, handle.get());
        const bool is_same = written.size() == size && std::memcmp(written.data(), payload, size) == 0;
        n_different += !is_same;
        if (only_counts)
            n_number += numbers(handle.get());
        else
            std::cout << (is_same ? "same " : "differs ") << json(handle.get()) << '\n';
    }
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begun;
    if (only_counts) std::cout << n << ' ' << n_different << ' ' << n_number << ' ' << took.count() << '\n';
}
