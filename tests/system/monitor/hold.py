"""Runs a program. A line on standard input stops one of its threads as a debugger would; the next line
continues it. Usage: hold.py THREAD PROGRAM [ARGUMENT...]"""

import ctypes
import os
import subprocess
import sys

PTRACE_SEIZE, PTRACE_INTERRUPT, PTRACE_DETACH = 0x4206, 0x4207, 17
WALL = 0x40000000

libc = ctypes.CDLL(None, use_errno=True)


def ptrace(request, tid):
    if libc.ptrace(request, tid, None, None) != 0:
        sys.exit(f"ptrace {request:#x}: {os.strerror(ctypes.get_errno())}")


def thread(process, name):
    for tid in os.listdir(f"/proc/{process}/task"):
        with open(f"/proc/{process}/task/{tid}/comm") as comm:
            if comm.read().strip() == name:
                return int(tid)
    sys.exit(f"no thread {name}")


program = subprocess.Popen(sys.argv[2:], stdin=subprocess.DEVNULL)
try:
    sys.stdin.readline()
    held = thread(program.pid, sys.argv[1])
    ptrace(PTRACE_SEIZE, held)
    ptrace(PTRACE_INTERRUPT, held)
    os.waitpid(held, WALL)
    sys.stdin.readline()
    ptrace(PTRACE_DETACH, held)
    sys.stdin.readline()
finally:
    program.kill()
