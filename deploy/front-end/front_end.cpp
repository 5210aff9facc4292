// front_end.cpp: skeleton of a front end in C++ that hands over looks. Replace `measured`.
//
//   g++ -std=c++17 -DMSGPACK_NO_BOOST front_end.cpp -o front_end               question on stdin, answer on stdout
//   PICO="-DZENOHCXX_ZENOHPICO -DZENOH_LINUX $(pkg-config --cflags zenohpico)"; LIBS="$(pkg-config --libs zenohpico) -lpthread"
//   g++ -std=c++17 -DMSGPACK_NO_BOOST -DWITH_ZENOH $PICO front_end.cpp $LIBS -o front_end                a process of a radar
//   g++ -std=c++17 -DMSGPACK_NO_BOOST -DWITH_ZENOH -DZENOHCXX_ZENOHC front_end.cpp -lzenohc -o front_end          the same
//
// The first one is compiled and tested with cogradar. The others need zenoh-cpp; its tests compile and ask the second one
// where zenoh-cpp and zenoh-pico are installed (tried with 1.9.0). With zenoh-c it was not compiled yet.

#include <atomic>
#include <complex>
#include <cstdint>
#include <cstring>
#include <iostream>
#include <iterator>
#include <map>
#include <msgpack.hpp>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

using Bytes = std::vector<std::uint8_t>;
using Packer = msgpack::packer<msgpack::sbuffer>;
constexpr int PROTOCOL = 10, SCHEMA = 2, N_TX = 16, N_RX = 16;

// Elements of an array, row by row, and the lengths of its axes.
template <class T> struct Array {
    std::vector<std::uint32_t> shape;
    std::vector<T> values;
};

template <class T> const char* name_of();
template <> const char* name_of<std::int32_t>() { return "i4"; }
template <> const char* name_of<double>() { return "f8"; }
template <> const char* name_of<std::complex<float>>() { return "c8"; }

// An array is extension type 1: element type, number of axes, their lengths, elements; all little-endian, as this machine.
template <class T> Array<T> array_in(const msgpack::object& value) {
    if (value.type != msgpack::type::EXT || value.via.ext.type() != 1) throw std::runtime_error("no array");
    const char* data = value.via.ext.data();
    const std::size_t size = value.via.ext.size, n_axis = size > 2 ? static_cast<std::uint8_t>(data[2]) : 9;
    if (n_axis > 2 || size < 3 + 4 * n_axis || std::memcmp(data, name_of<T>(), 2) != 0) throw std::runtime_error("other array");
    Array<T> array{std::vector<std::uint32_t>(n_axis), {}};
    std::memcpy(array.shape.data(), data + 3, 4 * n_axis);
    std::size_t n = 1;
    for (std::uint32_t length : array.shape) n *= length;
    if (size != 3 + 4 * n_axis + n * sizeof(T)) throw std::runtime_error("array of another length");
    array.values.resize(n);
    if (n) std::memcpy(array.values.data(), data + 3 + 4 * n_axis, n * sizeof(T));
    return array;
}

template <class T> void put(Packer& to, const char* key, const std::vector<T>& values) {
    const std::uint32_t n = static_cast<std::uint32_t>(values.size()), size = 7 + n * sizeof(T);
    std::string head(name_of<T>(), 2);
    head.push_back(1);
    head.append(reinterpret_cast<const char*>(&n), 4);
    to.pack(std::string(key));
    to.pack_ext(size, 1);
    to.pack_ext_body(head.data(), 7);
    to.pack_ext_body(reinterpret_cast<const char*>(values.data()), n * sizeof(T));
}

template <class T> void put_one(Packer& to, const char* key, const T& value) {
    to.pack(std::string(key));
    to.pack(value);
}

// The fields of a message of this kind.
std::map<std::string, msgpack::object> body_of(const msgpack::object_handle& message, const std::string& topic) {
    auto envelope = message->as<std::map<std::string, msgpack::object>>();
    if (envelope.at("v").as<int>() != SCHEMA || envelope.at("topic").as<std::string>() != topic)
        throw std::runtime_error("another message or schema");
    return envelope.at("body").as<std::map<std::string, msgpack::object>>();
}

void begin(Packer& to, const char* topic, std::uint32_t n_field) {
    to.pack_map(3);
    put_one(to, "v", SCHEMA);
    put_one(to, "topic", std::string(topic));
    to.pack(std::string("body"));
    to.pack_map(n_field);
}

// Drawn at each start: the radar knows by it that this is another process.
const std::string& incarnation() {
    static const std::string drawn = [] { std::random_device random; return std::to_string(random()) + "-" + std::to_string(random()); }();
    return drawn;
}

struct Dwell {
    std::string run;
    std::int64_t k, t;
    double deadline_s, isotropic;
    Array<std::complex<float>> factor;  // (N_TX, beams)
    Array<std::int32_t> bins;           // of each look, as all below
    Array<double> nus, limits;
    Array<std::int32_t> first_cells, n_cells, merged;
};

// A row of an answer, a cell of a look: range_km is the centre of its range cell, 0 if there are none; nu_hat is the
// direction of the echo, that of the look if it was not measured, and then nu_sigma is 0.
struct Cell {
    double statistic, sigma_hat, signature_power;
    std::complex<float> alpha_hat;
    double range_km, nu_hat, nu_sigma;
};

std::atomic<double> range_cell_km{0.0};  // of the radar that was opened last

// What the receiver measured in each look of a dwell, the strongest of its range cells. Here: nothing but noise.
std::vector<Cell> measured(const Dwell& dwell) {
    std::vector<Cell> cells;
    for (std::size_t i = 0; i < dwell.bins.values.size(); ++i) {
        const double range_km = dwell.n_cells.values.at(i) ? (dwell.first_cells.values.at(i) + 0.5) * range_cell_km : 0.0;
        cells.push_back({0.0, 1.0, dwell.isotropic * N_RX, {0.0f, 0.0f}, range_km, dwell.nus.values.at(i), 0.0});
    }
    return cells;
}

Bytes answer_opening(const Bytes& question) {
    auto message = msgpack::unpack(reinterpret_cast<const char*>(question.data()), question.size());
    auto opening = body_of(message, "opening");
    using Table = std::map<std::string, msgpack::object>;
    range_cell_km = opening.at("radar").as<Table>().at("receiver").as<Table>().at("range_cell_km").as<double>();
    msgpack::sbuffer out;
    Packer to(out);
    begin(to, "hello", 7);
    put_one(to, "run", opening.at("run").as<std::string>());
    put_one(to, "incarnation", incarnation());
    put_one(to, "n_tx", N_TX);
    put_one(to, "n_rx", N_RX);
    put_one(to, "hands_over", std::string("looks"));
    put_one(to, "max_rate_hz", 100.0);
    put_one(to, "clock", std::string("none"));
    return Bytes(out.data(), out.data() + out.size());
}

Bytes answer_dwell(const Bytes& question) {
    auto message = msgpack::unpack(reinterpret_cast<const char*>(question.data()), question.size());
    auto asked = body_of(message, "transmit");
    const Dwell dwell{asked.at("run").as<std::string>(),
                      asked.at("k").as<std::int64_t>(),
                      asked.at("t").as<std::int64_t>(),
                      asked.at("deadline_s").as<double>(),
                      asked.at("isotropic").as<double>(),
                      array_in<std::complex<float>>(asked.at("factor")),
                      array_in<std::int32_t>(asked.at("bins")),
                      array_in<double>(asked.at("nus")),
                      array_in<double>(asked.at("limits")),
                      array_in<std::int32_t>(asked.at("first_cells")),
                      array_in<std::int32_t>(asked.at("n_cells")),
                      array_in<std::int32_t>(asked.at("merged"))};
    const std::vector<Cell> cells = measured(dwell);
    const auto bin_of = [&dwell](std::size_t i) { return dwell.bins.values.at(i); };
    std::map<std::int32_t, std::size_t> strongest;  // of the merged looks of a bin, of which one is reported
    for (std::size_t i = 0; i < cells.size(); ++i) {
        if (!dwell.merged.values.at(i)) continue;
        const auto found = strongest.emplace(bin_of(i), i).first;
        if (cells[i].statistic > cells[found->second].statistic) found->second = i;
    }
    std::vector<std::int32_t> bins;
    std::vector<double> statistic, sigma_hat, signature_power, nus, limits, ranges_km, nu_hats, nu_sigmas;
    std::vector<std::complex<float>> alpha_hat;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        if (dwell.merged.values.at(i) && strongest.at(bin_of(i)) != i) continue;
        const Cell& cell = cells[i];
        bins.push_back(bin_of(i));
        nus.push_back(dwell.nus.values.at(i));
        limits.push_back(dwell.limits.values.at(i));
        statistic.push_back(cell.statistic);
        sigma_hat.push_back(cell.sigma_hat);
        signature_power.push_back(cell.signature_power);
        alpha_hat.push_back(cell.alpha_hat);
        ranges_km.push_back(cell.range_km);
        nu_hats.push_back(cell.nu_hat);
        nu_sigmas.push_back(cell.nu_sigma);
    }
    msgpack::sbuffer out;
    Packer to(out);
    begin(to, "received", 13);
    put_one(to, "run", dwell.run);
    put_one(to, "incarnation", incarnation());
    put_one(to, "k", dwell.k);
    put(to, "bins", bins);
    put(to, "statistic", statistic);
    put(to, "alpha_hat", alpha_hat);
    put(to, "sigma_hat", sigma_hat);
    put(to, "signature_power", signature_power);
    put(to, "nus", nus);
    put(to, "limits", limits);
    put(to, "ranges_km", ranges_km);
    put(to, "nu_hats", nu_hats);
    put(to, "nu_sigmas", nu_sigmas);
    return Bytes(out.data(), out.data() + out.size());
}

#ifndef WITH_ZENOH

int main(int n, char** words) {
    const std::string which = n >= 2 ? words[1] : "";
    const Bytes question{std::istreambuf_iterator<char>(std::cin), {}};
    try {
        if (n > 3 || (which != "opening" && which != "dwell")) throw std::runtime_error("front_end opening|dwell [RANGE_CELL_KM]");
        if (n == 3) range_cell_km = std::stod(words[2]);
        const Bytes answer = which == "opening" ? answer_opening(question) : answer_dwell(question);
        std::cout.write(reinterpret_cast<const char*>(answer.data()), static_cast<std::streamsize>(answer.size()));
    } catch (const std::exception& error) {
        std::cerr << error.what() << "\n";
        return 2;
    }
}

#else

#include <zenoh.hxx>

int main(int n, char** words) {
    if (n != 3) return std::cerr << "front_end NAME ENDPOINT, as roof tcp/127.0.0.1:7448\n", 2;
    auto config = zenoh::Config::create_default();
#ifdef ZENOHCXX_ZENOHPICO
    config.insert(Z_CONFIG_MODE_KEY, Z_CONFIG_MODE_PEER);
    config.insert(Z_CONFIG_LISTEN_KEY, words[2]);
    config.insert(Z_CONFIG_MULTICAST_SCOUTING_KEY, "false");
#else
    config.insert_json5("mode", "\"peer\"");
    config.insert_json5("listen/endpoints", "[\"" + std::string(words[2]) + "\"]");
    config.insert_json5("scouting/multicast/enabled", "false");
#endif
    auto session = zenoh::Session::open(std::move(config));
    auto answering = [](Bytes (*answer)(const Bytes&)) {
        return [answer](zenoh::Query& query) {  // the query is dropped at the end, which the radar waits for
            try {
                query.reply(query.get_keyexpr(), zenoh::Bytes(answer(query.get_payload().value().get().as_vector())));
            } catch (const std::exception& error) {
                query.reply_err(zenoh::Bytes(std::string(error.what())));
            }
        };
    };
    const std::string key = "cogradar/" + std::to_string(PROTOCOL) + "/front-end/" + words[1];
    auto opening = session.declare_queryable(zenoh::KeyExpr(key + "/opening"), answering(answer_opening), zenoh::closures::none);
    auto dwell = session.declare_queryable(zenoh::KeyExpr(key + "/dwell"), answering(answer_dwell), zenoh::closures::none);
    std::cin.get();
}

#endif
