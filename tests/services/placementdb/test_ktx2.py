"""KTX2 pages: the container of the specification, field by field, exact texels, and every damage refused."""

import struct

import numpy as np
import pytest
import zstandard
from farfield.errors import ColumnsAltered
from farfield.placementdb import ktx2
from farfield.placementdb.layout import LEVELS, PAGE_HEIGHT, PAGE_WIDTH
from farfield.placementdb.pages import NotAPage, decode, encode, page_image
from farfield.placementdb.read import Placement
from farfield.placementdb.write import build_files
from placements import made_up, texels

SIDES = [size for _, _, size in LEVELS]


def pyramid(sides=(16, 8, 4), seed=0):
    rng = np.random.default_rng(seed)
    return [rng.integers(0, 256, (s, s, 4), dtype=np.uint8) for s in sides]


def test_levels_come_back_exactly():
    levels = pyramid()
    for a, b in zip(levels, ktx2.decode(ktx2.encode(levels), [16, 8, 4]), strict=True):
        np.testing.assert_array_equal(a, b)
    assert ktx2.encode(levels) == ktx2.encode(pyramid())


def test_the_container_is_that_of_the_specification():
    """Read with nothing but the byte offsets that KTX 2.0 and the Data Format Specification print."""
    levels = pyramid()
    data = ktx2.encode(levels)
    assert data[:12] == bytes([0xAB, 0x4B, 0x54, 0x58, 0x20, 0x32, 0x30, 0xBB, 0x0D, 0x0A, 0x1A, 0x0A])
    vk, type_size, width, height, depth, layers, faces, n, scheme = struct.unpack_from("<9I", data, 12)
    assert (vk, type_size, width, height, depth, layers, faces, n, scheme) == (43, 1, 16, 16, 0, 0, 1, 3, 2)
    dfd, dfd_length, kvd, kvd_length = struct.unpack_from("<4I", data, 48)
    assert struct.unpack_from("<2Q", data, 64) == (0, 0)  # no global data of a supercompression
    index = [struct.unpack_from("<3Q", data, 80 + 24 * k) for k in range(3)]
    assert dfd == 80 + 24 * 3
    assert dfd % 4 == kvd % 4 == 0
    assert kvd == dfd + dfd_length
    # Smallest level first, one behind the other, to the end of the file.
    assert index[2][0] == kvd + kvd_length
    assert [index[1][0], index[0][0], len(data)] == [sum(index[k][:2]) for k in (2, 1, 0)]
    for (at, length, raw), level in zip(index, levels, strict=True):
        assert raw == level.size
        assert zstandard.ZstdDecompressor().decompress(data[at : at + length]) == level.tobytes()
    total, vendor_type, version, block = struct.unpack_from("<IIHH", data, dfd)
    assert (total, vendor_type, version, block) == (dfd_length, 0, 2, 24 + 4 * 16)
    assert list(data[dfd + 12 : dfd + 16]) == [1, 1, 2, 0]  # RGBSDA, BT.709, sRGB, straight alpha
    assert list(data[dfd + 16 : dfd + 28]) == [0, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0]  # a texel of 4 bytes
    for k, channel in enumerate((0, 1, 2, 0x1F)):  # R, G, B, alpha that is linear
        sample = struct.unpack_from("<HBB4BII", data, dfd + 28 + 16 * k)
        assert sample == (8 * k, 7, channel, 0, 0, 0, 0, 0, 255)
    entries, at = [], kvd
    while at < kvd + kvd_length:
        (length,) = struct.unpack_from("<I", data, at)
        entries.append(data[at + 4 : at + 4 + length].split(b"\0")[:2])
        at += 4 + length + -length % 4
    assert at == kvd + kvd_length
    assert entries == [[b"KTXorientation", b"rd"], [b"KTXwriter", b"farfield"]]


def test_what_is_damaged_is_refused():
    data = ktx2.encode(pyramid())
    for n in range(0, len(data)):
        with pytest.raises(ktx2.NotKtx2):
            ktx2.decode(data[:n], [16, 8, 4])
    for at, value in ((12, 37), (20, 32), (40, 9), (44, 0), (80, 10**9), (96, 5)):
        bad = bytearray(data)
        struct.pack_into("<I", bad, at, value)
        with pytest.raises(ktx2.NotKtx2):
            ktx2.decode(bytes(bad), [16, 8, 4])
    with pytest.raises(ktx2.NotKtx2):
        ktx2.decode(data, [16, 8])


@pytest.mark.parametrize("page_format", ["webp", "png", "ktx2"])
def test_every_format_holds_a_page_exactly(page_format):
    image = page_image([(0, 0, texels(64, 64, 1)), (64, 0, texels(100, 30, 2))])
    found = decode(encode(image, page_format), page_format)
    assert found.shape == (PAGE_HEIGHT, PAGE_WIDTH, 4)
    np.testing.assert_array_equal(found, image)
    assert ((image[..., 3] == 0) & (image[..., :3] > 0).any(-1)).any(), "colour under alpha 0 is what is at stake"
    with pytest.raises(NotAPage):
        decode(b"nothing", page_format)


@pytest.mark.parametrize("page_format", ["png", "ktx2"])
def test_a_placement_states_its_format(tmp_path, page_format):
    plain = build_files(**made_up(seed=4, wide=False))
    files = build_files(**made_up(seed=4, wide=False, page_format=page_format))
    for folder, content in (("a", plain), ("b", files)):
        for name, data in content.items():
            (tmp_path / folder / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / folder / name).write_bytes(data)
    a, b = Placement.open(tmp_path / "a"), Placement.open(tmp_path / "b")
    assert (a.manifest["version"], b.manifest["version"]) == (6, 6)
    assert b.manifest["page"]["format"] == page_format
    assert "format" not in a.manifest["page"]
    assert [entry["file"].split(".")[1] for entry in b.manifest["pages"]] == [page_format] * len(a.manifest["pages"])
    for k in range(len(a.manifest["pages"])):
        np.testing.assert_array_equal(a.page(k), b.page(k))
    assert b.check() == a.check()
    b.manifest["page"]["format"] = "webp"
    with pytest.raises(ColumnsAltered, match=b.manifest["pages"][0]["file"]):
        b.page(0)
