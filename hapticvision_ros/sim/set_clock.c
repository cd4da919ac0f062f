/*
 * Copyright 2026 The hapticvision_ros developers
 *
 * Licensed under the Apache License, Version 2.0 (the "License");
 * you may not use this file except in compliance with the License.
 * You may obtain a copy of the License at
 *
 *     http://www.apache.org/licenses/LICENSE-2.0
 *
 * Unless required by applicable law or agreed to in writing, software
 * distributed under the License is distributed on an "AS IS" BASIS,
 * WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
 * See the License for the specific language governing permissions and
 * limitations under the License.
 */

/*
 * A machine's clock that can be set, for those processes alone that load this library first.
 *
 * The campaign of faults writes by how much into a file of eight bytes, which the library maps.
 * What waits until a time of day waits by the clock that was set, as the kernel would have it:
 * such a wait that began before the clock was set back becomes longer by as much.
 */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SECOND INT64_C(1000000000)
/* Longest time in which a waiting thread does not see that the clock was set [ns]. */
#define SLICE (SECOND / 50)
/* A condition may count in the time since the machine started: less than this [ns]. */
#define TIME_OF_DAY (SECOND * SECOND)

static _Atomic int64_t not_set;
static _Atomic int64_t *set_by = &not_set;

__attribute__((constructor)) static void map(void)
{
  const char *name = getenv("HAPTICVISION_SET_CLOCK");
  int file = name == NULL ? -1 : open(name, O_RDONLY | O_CLOEXEC);
  if (file < 0) {
    return;
  }
  void *at = mmap(NULL, sizeof(*set_by), PROT_READ, MAP_SHARED, file, 0);
  close(file);
  if (at != MAP_FAILED) {
    set_by = at;
  }
}

/* The function that this library hides: of the version that programs are linked with. */
static void *hidden(const char *name, const char *version)
{
  void *found = version == NULL ? NULL : dlvsym(RTLD_NEXT, name, version);
  return found == NULL ? dlsym(RTLD_NEXT, name) : found;
}

#define HIDDEN(name, version) \
  static __typeof__(name) *real; \
  if (real == NULL) { \
    real = (__typeof__(name) *)hidden(#name, version); \
  }

static int64_t ns(const struct timespec *time)
{
  return time->tv_sec * SECOND + time->tv_nsec;
}

static struct timespec spec(int64_t time)
{
  return (struct timespec){.tv_sec = time / SECOND, .tv_nsec = time % SECOND};
}

static int machine_clock(clockid_t clock, struct timespec *time)
{
  HIDDEN(clock_gettime, NULL)
  return real(clock, time);
}

int clock_gettime(clockid_t clock, struct timespec *time)
{
  int result = machine_clock(clock, time);
  if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
    *time = spec(ns(time) + *set_by);
  }
  return result;
}

static int64_t now(void)
{
  struct timespec time;
  clock_gettime(CLOCK_REALTIME, &time);
  return ns(&time);
}

static int64_t earlier(int64_t a, int64_t b)
{
  return a < b ? a : b;
}

time_t time(time_t *to)
{
  time_t seconds = now() / SECOND;
  if (to != NULL) {
    *to = seconds;
  }
  return seconds;
}

int gettimeofday(struct timeval *restrict to, void *restrict zone)
{
  int64_t time = now();
  (void)zone;
  to->tv_sec = time / SECOND;
  to->tv_usec = time % SECOND / 1000;
  return 0;
}

/* The end, by the kernel's clock, of the next slice of a wait until `end`. */
static struct timespec slice(int64_t end)
{
  /* Read once: it may be set in between, and an hour be slept for it. */
  int64_t by = *set_by;
  struct timespec machine;
  machine_clock(CLOCK_REALTIME, &machine);
  return spec(earlier(end - by, ns(&machine) + SLICE));
}

int pthread_cond_timedwait(
  pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
  const struct timespec *restrict until)
{
  HIDDEN(pthread_cond_timedwait, "GLIBC_2.3.2")
  int64_t end = ns(until);
  if (end < TIME_OF_DAY) {
    return real(condition, mutex, until);
  }
  struct timespec next = slice(end);
  int result = real(condition, mutex, &next);
  /* Who is woken without a reason looks and waits on: a signal between two slices is not lost. */
  return result == ETIMEDOUT && now() < end ? 0 : result;
}

int pthread_mutex_timedlock(
  pthread_mutex_t *restrict mutex, const struct timespec *restrict until)
{
  HIDDEN(pthread_mutex_timedlock, NULL)
  int64_t end = ns(until);
  int result;
  do {
    struct timespec next = slice(end);
    result = real(mutex, &next);
  } while (result == ETIMEDOUT && now() < end);
  return result;
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict until)
{
  HIDDEN(sem_timedwait, NULL)
  int64_t end = ns(until);
  int result;
  do {
    struct timespec next = slice(end);
    result = real(semaphore, &next);
  } while (result != 0 && errno == ETIMEDOUT && now() < end);
  return result;
}
