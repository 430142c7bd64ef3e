"""A slow network between browser and daemon: passes connections on, so many bytes a second from the daemon.

Its sockets hold 4 kB, as a network does little: Node cannot make a socket's buffer small, and 64 kB and more
would wait in it. Lines on standard input are limits in bytes a second, 0 for none.
"""

import socket
import sys
import threading
import time

CHUNK = 512
BUFFER = 4096
rate = 0.0
free_at = 0.0
turn = threading.Lock()


def wait_for_turn(count):
    """Until the network has time for so many bytes more."""
    global free_at
    with turn:
        if not rate:
            return
        now = time.monotonic()
        free_at = max(free_at, now) + count / rate
        until = free_at
    time.sleep(max(0.0, until - now))


def copy(source, target, slow):
    try:
        while True:
            data = source.recv(CHUNK if slow else 65536)
            if not data:
                break
            if slow:
                wait_for_turn(len(data))
            target.sendall(data)
    except OSError:
        pass
    for end in (source, target):
        try:
            end.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass


def serve(listener, port):
    while True:
        near, _ = listener.accept()
        near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        far = socket.socket()
        far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        far.connect(("127.0.0.1", port))
        for source, target, slow in ((far, near, True), (near, far, False)):
            threading.Thread(target=copy, args=(source, target, slow), daemon=True).start()


def main():
    global rate
    listener = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=serve, args=(listener, int(sys.argv[1])), daemon=True).start()
    print(f"the link listens port={listener.getsockname()[1]}", flush=True)
    for line in sys.stdin:
        rate = float(line)


main()
