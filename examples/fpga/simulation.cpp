// The system of rtl/soc/system.py in Verilator, with a memory of words behind its port and a terminal on its serial line.
//
//     simulation IMAGE_ADDRESS FRAME_ADDRESS FRAME_BYTES DIVISOR CYCLES IMAGE FRAME
//
// Puts the file IMAGE into memory, runs the processor's firmware until it writes an end into `status`, and writes FRAME_BYTES
// of memory at FRAME_ADDRESS to the file FRAME. Prints what comes over the serial line, and at the end `status` and cycles.
// Exit status: 0 where the firmware is done, 1 where it failed, 2 where nothing ended within CYCLES cycles or the processor
// met an instruction that it does not know, 98 for bad arguments.
// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <vector>

#include "Vsystem.h"
#include "verilated.h"

namespace {

constexpr uint32_t kBytes = 32u << 20;  // of main memory
constexpr uint32_t kLatency = 3;        // cycles from an access to its answer
constexpr uint32_t kDone = 2, kFailed = 0x80;

uint32_t number(const char *text) { return static_cast<uint32_t>(std::strtoul(text, nullptr, 0)); }

// Shows the bytes that come over the line.
class Terminal {
public:
    explicit Terminal(uint32_t divisor) : divisor_(divisor) {}

    void sample(bool line) {
        if (!bits_) {
            if (!line) {
                bits_ = 10;
                wait_ = divisor_ + divisor_ / 2;
            }
            return;
        }
        if (--wait_) return;
        wait_ = divisor_;
        if (--bits_ > 1) {
            byte_ = byte_ >> 1 | static_cast<uint32_t>(line) << 7;
        } else {
            if (!line) std::fprintf(stderr, "a byte on the serial line has no stop bit\n");
            std::putchar(static_cast<int>(byte_ & 255u));
            std::fflush(stdout);
            bits_ = 0;
        }
    }

private:
    uint32_t divisor_, bits_ = 0, wait_ = 0, byte_ = 0;
};

}  // namespace

int main(int argc, char **argv) {
    if (argc != 8) {
        std::fprintf(stderr, "usage: %s IMAGE_ADDRESS FRAME_ADDRESS FRAME_BYTES DIVISOR CYCLES IMAGE FRAME\n", argv[0]);
        return 98;
    }
    const uint32_t at = number(argv[1]), frame = number(argv[2]), bytes = number(argv[3]);
    std::ifstream file(argv[6], std::ios::binary);
    const std::vector<uint8_t> image{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
    if (!file || at > kBytes || image.size() > kBytes - at || frame > kBytes || bytes > kBytes - frame) {
        std::fprintf(stderr, "image or frame does not lie in %u bytes of memory\n", kBytes);
        return 98;
    }
    std::vector<uint8_t> memory(kBytes);
    for (uint32_t place = 0; place < kBytes; place++) memory[place] = static_cast<uint8_t>(place * 0x9e3779b1u >> 24);
    std::memcpy(memory.data() + at, image.data(), image.size());

    Vsystem top;
    Terminal terminal(number(argv[4]));
    const uint64_t most = std::strtoull(argv[5], nullptr, 0);
    uint32_t waited = 0;
    uint64_t cycle = 0;
    top.memory_ready = 0;
    uint64_t last = most;  // after the end the line still has two bytes to send
    for (; cycle < last && !top.trapped; cycle++) {
        if (last == most && (top.status == kDone || top.status & kFailed)) last = std::min(most, cycle + 24 * number(argv[4]));
        top.rst = cycle < 8;
        top.clk = 0;
        top.eval();
        if (top.memory_ready) {
            waited = 0;
        } else if (top.memory_valid && !top.rst) {
            waited++;
        }
        const bool now = waited >= kLatency && !top.memory_ready;
        const uint64_t place = 4ull * top.memory_address;
        const uint32_t strobe = top.memory_write, data = top.memory_write_data;
        if (now && place + 4 > kBytes) {
            std::fprintf(stderr, "an access to 0x%llx lies outside memory\n", static_cast<unsigned long long>(place));
            return 2;
        }
        top.clk = 1;
        top.eval();
        top.memory_ready = now;
        if (now) {
            for (uint32_t lane = 0; lane < 4; lane++)
                if (strobe >> lane & 1) memory[place + lane] = static_cast<uint8_t>(data >> 8 * lane);
            uint32_t word;
            std::memcpy(&word, memory.data() + place, 4);
            top.memory_read_data = word;
        }
        terminal.sample(top.serial);
    }
    std::printf("status %u cycles %llu\n", static_cast<unsigned>(top.status), static_cast<unsigned long long>(cycle));
    if (top.trapped) std::printf("the processor met an instruction that it does not know\n");
    std::ofstream out(argv[7], std::ios::binary);
    out.write(reinterpret_cast<const char *>(memory.data() + frame), static_cast<long>(bytes));
    return top.status == kDone ? 0 : top.status & kFailed ? 1 : 2;
}
