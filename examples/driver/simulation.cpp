// A port of the driver to the RTL in Verilator: registers over AXI4-Lite, and a memory behind the machine's AXI4 port.
//
//     simulation ADDRESS TIMEOUT IMAGE FRAME [IMAGE FRAME ...]
//
// Runs demo() on each frame image IMAGE in turn, at byte address ADDRESS, and writes the memory of its frame to the file FRAME.
// Of a frame of two eyes it is the memory from the first eye's frame to the end of the second eye's. Behind packed frames follow
// their pixels, as msv2_unpack_frame gives them; a damaged one ends with exit status 97.
// There is no reset between frames, and none that fails is followed by another. A millisecond of the driver's timeout is
// 100,000 cycles here. The exit status is demo's; 99: the bus broke a rule.
// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <fstream>
#include <iterator>
#include <vector>

#include "Vmachine.h"
#include "demo.h"
#include "msv2_packed.h"
#include "verilated.h"

namespace {

constexpr uint32_t kBeat = 32;          // bytes of a beat
constexpr uint32_t kLatency = 40;       // cycles from a request to memory to its answer
constexpr size_t kMostRequests = 64;    // requests that memory takes before it stops being ready
constexpr uint32_t kMillisecond = 100000;
constexpr uint32_t kPatience = 10000;   // cycles within which the registers must answer

[[noreturn]] void broken(const char *what) {
    std::fprintf(stderr, "the bus broke a rule: %s\n", what);
    std::exit(99);
}

// Answers every request in order. Each transaction of the machine is a single beat.
class Memory {
public:
    explicit Memory(size_t bytes) : cells_(bytes) {
        for (size_t place = 0; place < bytes; place++) cells_[place] = static_cast<uint8_t>(place * 0x9e3779b1u >> 24);
    }

    uint8_t *at(uint64_t address, size_t bytes) {
        if (address + bytes > cells_.size()) broken("an address lies outside memory");
        return cells_.data() + address;
    }

    // Before the rising edge: what moves at it.
    void sample(const Vmachine &top) {
        if (top.m_axi_arvalid && top.m_axi_arready) {
            shape(top.m_axi_arlen, top.m_axi_arsize, top.m_axi_araddr);
            reads_.push_back({static_cast<uint32_t>(top.m_axi_arid), top.m_axi_araddr, now_ + kLatency});
        }
        if (top.m_axi_awvalid && top.m_axi_awready) {
            shape(top.m_axi_awlen, top.m_axi_awsize, top.m_axi_awaddr);
            writes_.push_back({static_cast<uint32_t>(top.m_axi_awid), top.m_axi_awaddr, now_ + kLatency});
        }
        if (top.m_axi_wvalid && top.m_axi_wready) {
            if (!top.m_axi_wlast) broken("a burst has more than one beat");
            Data data{top.m_axi_wstrb, {}};
            std::memcpy(data.bytes, &top.m_axi_wdata[0], kBeat);
            data_.push_back(data);
        }
        if (top.m_axi_rvalid && top.m_axi_rready) reads_.pop_front();
        if (top.m_axi_bvalid && top.m_axi_bready) writes_.pop_front();
        now_++;
    }

    // After the rising edge: what memory offers until the next one. A write changes memory when it is first answered.
    void drive(Vmachine &top) {
        top.m_axi_arready = reads_.size() < kMostRequests;
        top.m_axi_awready = writes_.size() < kMostRequests;
        top.m_axi_wready = data_.size() < kMostRequests;
        top.m_axi_rvalid = !reads_.empty() && reads_.front().due <= now_;
        top.m_axi_rlast = 1;
        top.m_axi_rresp = 0;
        if (top.m_axi_rvalid) {
            top.m_axi_rid = reads_.front().id;
            std::memcpy(&top.m_axi_rdata[0], at(reads_.front().address, kBeat), kBeat);
        }
        if (!writes_.empty() && !writes_.front().done && !data_.empty() && writes_.front().due <= now_) {
            uint8_t *cell = at(writes_.front().address, kBeat);
            for (uint32_t lane = 0; lane < kBeat; lane++)
                if (data_.front().strobe >> lane & 1) cell[lane] = data_.front().bytes[lane];
            data_.pop_front();
            writes_.front().done = true;
        }
        top.m_axi_bvalid = !writes_.empty() && writes_.front().done;
        top.m_axi_bresp = 0;
        if (top.m_axi_bvalid) top.m_axi_bid = writes_.front().id;
    }

private:
    struct Request {
        uint32_t id;
        uint32_t address;
        uint64_t due;
        bool done = false;
    };
    struct Data {
        uint32_t strobe;
        uint8_t bytes[kBeat];
    };

    static void shape(uint32_t length, uint32_t size, uint32_t address) {
        if (length != 0 || size != 5 || address % kBeat != 0) broken("a transaction is not one aligned beat");
    }

    std::vector<uint8_t> cells_;
    std::deque<Request> reads_, writes_;
    std::deque<Data> data_;
    uint64_t now_ = 0;
};

class Simulation {
public:
    explicit Simulation(size_t bytes) : memory(bytes) {
        top.rst = 1;
        memory.drive(top);
        for (int cycle = 0; cycle < 4; cycle++) tick();
        top.rst = 0;
        tick();
    }

    void tick() {
        top.clk = 0;
        top.eval();
        if (!top.rst) memory.sample(top);
        top.clk = 1;
        top.eval();
        memory.drive(top);
    }

    uint32_t read(uint32_t offset) {
        top.s_axil_araddr = offset;
        top.s_axil_arvalid = 1;
        top.s_axil_rready = 1;
        uint32_t value = 0;
        for (uint32_t cycle = 0; cycle < kPatience; cycle++) {
            top.clk = 0;
            top.eval();
            const bool asked = top.s_axil_arvalid && top.s_axil_arready, answered = top.s_axil_rvalid;
            if (answered) {
                if (top.s_axil_rresp != 0) broken("a register answers a read with an error");
                value = top.s_axil_rdata;
            }
            tick();
            if (asked) top.s_axil_arvalid = 0;
            if (answered) {
                top.s_axil_rready = 0;
                return value;
            }
        }
        broken("a register does not answer a read");
    }

    void write(uint32_t offset, uint32_t value) {
        top.s_axil_awaddr = offset;
        top.s_axil_wdata = value;
        top.s_axil_wstrb = 0xF;
        top.s_axil_awvalid = top.s_axil_wvalid = top.s_axil_bready = 1;
        for (uint32_t cycle = 0; cycle < kPatience; cycle++) {
            top.clk = 0;
            top.eval();
            const bool addressed = top.s_axil_awvalid && top.s_axil_awready, given = top.s_axil_wvalid && top.s_axil_wready;
            const bool answered = top.s_axil_bvalid;
            if (answered && top.s_axil_bresp != 0) broken("a register answers a write with an error");
            tick();
            if (addressed) top.s_axil_awvalid = 0;
            if (given) top.s_axil_wvalid = 0;
            if (answered) {
                top.s_axil_bready = 0;
                return;
            }
        }
        broken("a register does not answer a write");
    }

    // `interrupt` is a word that Verilator keeps for itself, so the port has this name in C++.
    int wait(uint32_t timeout) {
        for (uint64_t cycle = 0; cycle < static_cast<uint64_t>(timeout) * kMillisecond; cycle++) {
            if (top.__SYM__interrupt) return 1;
            tick();
        }
        return top.__SYM__interrupt;
    }

    Vmachine top;
    Memory memory;
};

uint32_t number(const char *text) { return static_cast<uint32_t>(std::strtoul(text, nullptr, 0)); }

std::vector<uint8_t> contents(const char *name) {
    std::ifstream file(name, std::ios::binary);
    if (!file) {
        std::fprintf(stderr, "%s cannot be read\n", name);
        std::exit(98);
    }
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

struct Image {
    explicit Image(const char *name) : bytes(contents(name)) {
        if (msv2_image_open(&head, bytes.data(), size()) != MSV2_OK) head.memory = 0;
    }

    uint32_t size() const { return static_cast<uint32_t>(bytes.size()); }

    std::vector<uint8_t> bytes;
    msv2_image head{};
};

}  // namespace

extern "C" {

uint32_t msv2_read(void *port, uint32_t offset) { return static_cast<Simulation *>(port)->read(offset); }

void msv2_write(void *port, uint32_t offset, uint32_t value) { static_cast<Simulation *>(port)->write(offset, value); }

void msv2_store(void *port, uint32_t address, const uint8_t *bytes, uint32_t count) {
    if (count) std::memcpy(static_cast<Simulation *>(port)->memory.at(address, count), bytes, count);
}

int msv2_wait(void *port, uint32_t timeout) { return static_cast<Simulation *>(port)->wait(timeout); }

}

int main(int argc, char **argv) {
    if (argc < 5 || argc % 2 == 0) {
        std::fprintf(stderr, "usage: %s ADDRESS TIMEOUT IMAGE FRAME [IMAGE FRAME ...]\n", argv[0]);
        return 98;
    }
    const uint32_t address = number(argv[1]), timeout = number(argv[2]);
    std::deque<Image> images;
    uint32_t most = 0;
    for (int place = 3; place < argc; place += 2) {
        images.emplace_back(argv[place]);
        most = std::max(most, images.back().head.memory);
    }
    Simulation simulation(static_cast<size_t>(address) + most);
    for (size_t place = 0; place < images.size(); place++) {
        const Image &image = images[place];
        const int result = demo(&simulation, image.bytes.data(), image.size(), address, timeout);
        if (result != 0) return result;
        const uint32_t width = image.head.width, height = image.head.height;
        const size_t pixels = static_cast<size_t>(width) * height;
        const bool packed = image.head.pixel_bytes == 0;
        const size_t bytes = packed ? msv2_packed_bytes(width, height) : pixels * image.head.pixel_bytes;
        const uint32_t last = image.head.target ? image.head.target : image.head.frame;
        const size_t all = last - image.head.frame + bytes;
        const uint8_t *frames = simulation.memory.at(static_cast<uint64_t>(address) + image.head.frame, all);
        std::ofstream out(argv[4 + 2 * place], std::ios::binary);
        out.write(reinterpret_cast<const char *>(frames), static_cast<long>(all));
        for (uint32_t eye = 0; packed && eye <= (image.head.target != 0); eye++) {
            const uint8_t *frame = frames + (eye ? last - image.head.frame : 0);
            std::vector<uint8_t> unpacked(4 * pixels);
            msv2_packed_damage damage{};
            if (msv2_unpack_frame(frame, static_cast<uint32_t>(bytes), width, height, unpacked.data(), &damage) !=
                MSV2_PACKED_WHOLE) {
                std::fprintf(stderr, "%u blocks are damaged; block %u: error %d\n", static_cast<unsigned>(damage.blocks),
                             static_cast<unsigned>(damage.block), static_cast<int>(damage.error));
                return 97;
            }
            out.write(reinterpret_cast<const char *>(unpacked.data()), static_cast<long>(unpacked.size()));
        }
    }
    return 0;
}
