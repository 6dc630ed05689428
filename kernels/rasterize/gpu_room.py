"""Device memory that the GPU's shape keeps between steps, and a count of intersections that nobody waits for.

How many intersections a view has is known on the device alone. To read it before compositing would stop the host until
the device has caught up, in every step. So the memory has room for more than were last seen, the step runs within that
room, and the count travels to the host meanwhile; the backward pass looks at it, when the device has work queued.
"""

import ctypes
from functools import cache
from weakref import finalize

import warp as wp

from graphgs.kernels.arrays import carve, packed_size, view


class IntersectionOverflow(RuntimeError):
    """A view had more intersections than there was room for. The room has grown: repeat the step."""

    def __init__(self, count: int, capacity: int) -> None:
        super().__init__(
            f"{count} intersections of splats and tiles, but room for {capacity}: the room has grown, repeat the step"
        )
        self.count = count
        self.capacity = capacity


class Count:
    """A number on its way from the device."""

    def __init__(self, device: wp.Device, capacity: int, mailboxes: list) -> None:
        """`mailboxes` are pinned memory and events that are free; this one's go back there at the end of its life."""
        self.capacity = capacity  # of the lists that were made with it
        if not mailboxes:
            event = wp.Event(device) if device.is_cuda else None
            mailboxes.append((wp.empty(1, dtype=int, device="cpu", pinned=device.is_cuda), event))
        self.value, self._event = mailbox = mailboxes.pop()  # a kernel writes the value, over the bus
        self._device = device
        finalize(self, mailboxes.append, mailbox)

    def send(self) -> None:
        """The kernel that writes it was launched."""
        if self._event is not None:
            self._device.stream.record_event(self._event)

    def read(self) -> int:
        """Wait until it has arrived."""
        if self._event is not None:
            wp.synchronize_event(self._event)
        return ctypes.c_int.from_address(self.value.ptr).value


class _Loan:
    """What borrowed arrays hold on to."""


class Room:
    """Memory of one device and stream, so that who comes later also runs later."""

    def __init__(self, device, *, deferred: bool) -> None:
        self.device = wp.get_device(device)
        self.capacity = 0  # intersections
        self.deferred = deferred  # whether counts are looked at afterwards
        self._scratch: dict[str, wp.array] = {}
        self._free: dict[str, list[wp.array]] = {}
        self._seen: tuple[int, ...] | None = None
        self._mailboxes: list = []

    def scratch(self, name: str, size: int, dtype=int) -> wp.array:
        """An array of `size` elements of any content; it belongs to the caller until the next one asks by that name."""
        needed = size * wp.types.type_size_in_bytes(dtype)
        block = self._scratch.get(name)
        if block is None or block.size < needed:
            block = self._scratch[name] = wp.empty(max(needed, 1), dtype=wp.uint8, device=self.device)
        return view(block.ptr, dtype, (size,), self.device, block)

    def lend(self, name: str, *wanted: tuple[type, int]) -> list[wp.array]:
        """Arrays, given as (dtype, size), of any content; the memory comes back here when the last of them is gone."""
        free, needed = self._free.setdefault(name, []), packed_size(*wanted)
        block = free.pop() if free else None
        if block is None or block.size < needed:
            block = wp.empty(needed + needed // 4 + 256, dtype=wp.uint8, device=self.device)
        loan = _Loan()
        finalize(loan, free.append, block)
        return carve(block, loan, *wanted)

    def count(self) -> Count:
        """For the count of lists that are made with the present capacity."""
        return Count(self.device, self.capacity, self._mailboxes)

    def is_familiar(self, *sizes: int) -> bool:
        """Whether the last view had the same sizes, so that its count says how much room this one needs."""
        familiar = self._seen == sizes
        self._seen = sizes
        return familiar

    def fit(self, count: int) -> None:
        """Make room for `count` intersections, and more, since Gaussians move."""
        if count + count // 8 >= self.capacity:
            self.capacity = count + count // 2 + 256

    def check(self, count: Count) -> None:
        """Raise IntersectionOverflow if the lists made with this count are short."""
        needed = count.read()
        self.fit(needed)
        if needed > count.capacity:
            raise IntersectionOverflow(needed, count.capacity)


def shared_room(device) -> Room:
    """The room of the device's current stream. On the CPU a count is there as soon as it is asked for."""
    device = wp.get_device(device)
    return _room(device.alias, device.stream.cuda_stream if device.is_cuda else None)


@cache
def _room(device: str, stream: int | None) -> Room:
    return Room(device, deferred=stream is not None)
