#include "thread_pool.h"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <vector>

namespace mulan {

struct ThreadPool::State {
    std::vector<std::thread> workers;
    std::mutex mutex;
    std::condition_variable work, done;
    // guarded by the mutex
    bool open = false, stop = false;
    int active = 0;
    void (*enter)(const void*, ThreadPool&, int) = nullptr;
    const void* body = nullptr;
    // read without it
    std::atomic<uint64_t> loops{0};  // started so far
    std::atomic<int64_t> next{0};
    int64_t iterations = 0;

    void serve(ThreadPool& pool, int thread) {
        uint64_t seen = 0;
        for (;;) {
            // The loops of a training step follow each other within microseconds: look out for the next a moment
            // before going to sleep.
            const auto patience = std::chrono::steady_clock::now() + std::chrono::microseconds(40);
            while (loops.load(std::memory_order_relaxed) == seen && std::chrono::steady_clock::now() < patience) {
            }
            std::unique_lock<std::mutex> lock(mutex);
            work.wait(lock, [&] { return stop || loops.load(std::memory_order_relaxed) != seen; });
            if (stop) return;
            seen = loops.load(std::memory_order_relaxed);
            if (!open) continue;  // over before this thread woke
            ++active;
            lock.unlock();
            enter(body, pool, thread);
            lock.lock();
            if (--active == 0) done.notify_one();
        }
    }
};

ThreadPool::ThreadPool(int threads) : state_(new State) {
    try {
        for (int i = 1; i < threads; ++i) state_->workers.emplace_back([this, i] { state_->serve(*this, i); });
    } catch (...) {
        finish();  // the system gives no more threads: leave none behind
        throw;
    }
}

ThreadPool::~ThreadPool() { finish(); }

void ThreadPool::finish() {
    {
        std::lock_guard<std::mutex> lock(state_->mutex);
        state_->stop = true;
    }
    state_->work.notify_all();
    for (std::thread& worker : state_->workers) worker.join();
    delete state_;
}

int ThreadPool::threads() const { return (int)state_->workers.size() + 1; }

int64_t ThreadPool::claim() {
    const int64_t i = state_->next.fetch_add(1, std::memory_order_relaxed);
    return i < state_->iterations ? i : -1;
}

void ThreadPool::run(int64_t iterations, void (*enter)(const void*, ThreadPool&, int), const void* body) {
    State& s = *state_;
    const bool alone = s.workers.empty() || iterations <= 1;
    {
        std::lock_guard<std::mutex> lock(s.mutex);
        s.next.store(0, std::memory_order_relaxed);
        s.iterations = iterations;
        s.enter = enter;
        s.body = body;
        s.open = !alone;
        if (!alone) s.loops.fetch_add(1, std::memory_order_relaxed);
    }
    if (!alone) s.work.notify_all();
    enter(body, *this, 0);
    std::unique_lock<std::mutex> lock(s.mutex);
    s.open = false;
    s.done.wait(lock, [&] { return s.active == 0; });
}

}  // namespace mulan
