// Threads that share the iterations of a loop. Not OpenMP: its barriers wait for every thread even if that has nothing
// to do, and on a machine busy with other work each such wait costs a scheduler's time slice; here the caller works on
// until no iteration is left and waits only for those in progress. Included by code of every instruction set:
// declarations only.
#pragma once
#include <stdint.h>

namespace mulan {

class ThreadPool {
  public:
    explicit ThreadPool(int threads);
    ThreadPool(const ThreadPool&) = delete;
    ThreadPool& operator=(const ThreadPool&) = delete;
    ~ThreadPool();

    int threads() const;
    // Has enter(body, pool, thread) called by the caller (thread 0) and by whichever other threads are free; each
    // claims iterations until none is left. Returns when all are done. One loop at a time.
    void run(int64_t iterations, void (*enter)(const void* body, ThreadPool&, int thread), const void* body);
    // The next iteration of the running loop, or -1.
    int64_t claim();

  private:
    struct State;
    void finish();
    State* state_;
};

}  // namespace mulan
