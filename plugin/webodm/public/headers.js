/* Which bytes of an image file hold its metadata: JPEG segments up to the picture data, TIFF directories
   wherever they stand. The picture itself, thumbnails and raw thermal data are skipped. The reader on the
   server (stages/headers) decides what they mean; what it still lacks it asks for by offset and length. */
(function (sensorgate) {
  "use strict";

  var HEAD_BYTES = 32 * 1024;
  var BLOCK_BYTES = 8 * 1024;
  var JOIN_GAP_BYTES = 192;
  var MOST_RANGES = 200;
  var TEXT_BYTES = 1024;
  var MOST_XMP_BYTES = 4 * 1024 * 1024;
  var MOST_SEGMENTS = 4096;
  var MOST_ENTRIES = 4096;
  var MOST_DIRECTORIES = 256;
  var MOST_SUB_DIRECTORIES = 64;
  var MOST_STRIPS = 65536;
  var MOST_STEPS = 4096;
  var STRAY_BYTES = 64 * 1024;
  var SEARCH_BYTES = 1024 * 1024;
  var SIZES = { 1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8 };
  var MAKER_NOTE = 0x927c, USER_COMMENT = 0x9286, XMP_PACKET = 700, EXIF_IFD = 0x8769, GPS_IFD = 0x8825, SUB_IFDS = 330;
  var SUBFILE_TYPE = 254, WIDTH = 256, HEIGHT = 257, STRIPS = [273, 279, 324, 325, 513, 514];

  /* Thrown by the walk where a byte is wanted that has not been read from the file yet. */
  function Missing(offset, length) {
    this.offset = offset;
    this.length = length;
  }

  /* The parts of a file that were read so far, and the ranges that the walk asked for. */
  function Bytes(size) {
    this.size = size;
    this.parts = [];
    this.asked = [];
    this.endless = null;
  }
  Bytes.prototype.add = function (offset, data) {
    this.parts.push({ offset: offset, end: offset + data.length, data: data });
  };
  /* The bytes of a range, null beyond the end of the file. */
  Bytes.prototype.look = function (offset, length) {
    if (offset < 0 || length < 0 || offset + length > this.size) return null;
    for (var i = this.parts.length - 1; i >= 0; i--) {
      var part = this.parts[i];
      if (part.offset <= offset && offset + length <= part.end) {
        return part.data.subarray(offset - part.offset, offset - part.offset + length);
      }
    }
    throw new Missing(offset, length);
  };
  /* The same, noted as a range to send. */
  Bytes.prototype.want = function (offset, length) {
    var data = this.look(offset, length);
    if (data && length > 0) this.asked.push([offset, length]);
    return data;
  };
  /* What was asked for, in order; ranges close to each other are one, and so are farther ones where there are many. */
  Bytes.prototype.ranges = function () {
    this.asked.sort(function (a, b) { return a[0] - b[0] || a[1] - b[1]; });
    var gap = JOIN_GAP_BYTES, joined = join(this.asked, gap);
    while (joined.length > MOST_RANGES) joined = join(joined, (gap *= 4));
    return joined;
  };

  function join(ranges, gap) {
    var joined = [];
    ranges.forEach(function (range) {
      var last = joined[joined.length - 1];
      if (last && range[0] <= last[0] + last[1] + gap) {
        last[1] = Math.max(last[1], range[0] + range[1] - last[0]);
      } else {
        joined.push([range[0], range[1]]);
      }
    });
    return joined;
  }

  function starts(data, text) {
    if (!data || data.length < text.length) return false;
    for (var i = 0; i < text.length; i++) if (data[i] !== text.charCodeAt(i)) return false;
    return true;
  }

  function walk(bytes) {
    var start = bytes.want(0, Math.min(16, bytes.size));
    if (!start || start.length < 4) return;
    if (start[0] === 0xff && start[1] === 0xd8) return walkJpeg(bytes);
    if (starts(start, "II*\0") || starts(start, "MM\0*") || starts(start, "II+\0") || starts(start, "MM\0+")) {
      var stream = openStream(bytes, 0, bytes.size);
      if (stream) walkTiff(stream);
    }
  }

  function walkJpeg(bytes) {
    var at = 2;
    var extended = [], shape = { blocks: 0, interval: 0 };
    for (var n = 0; n < MOST_SEGMENTS && at + 4 <= bytes.size; n++) {
      var head = bytes.want(at, Math.min(46, bytes.size - at));
      var marker = head[1];
      if (head[0] !== 0xff || marker === 0xff || marker === 0) {
        at = nextMarker(bytes, at);
        if (at < 0) return;
        continue;
      }
      if (marker === 0x01 || (marker >= 0xd0 && marker <= 0xd7)) { at += 2; continue; }
      if (marker === 0xd8 || marker === 0xd9) return;
      var length = (head[2] << 8) | head[3];
      if (length < 2) return;
      if (marker === 0xda) return wantEnd(bytes, at, extended, shape);
      if (at + 2 + length > bytes.size) return;
      if (marker === 0xe1) {
        var body = head.subarray(4);
        if (starts(body, "Exif\0")) {
          var stream = openStream(bytes, at + 10, length - 8);
          if (stream) walkExif(stream, directory(stream, stream.first));
        } else if (starts(body, "http://ns.adobe.com/xap/1.0/\0")) {
          bytes.want(at + 4, length - 2);
        } else if (starts(body, "http://ns.adobe.com/xmp/extension/\0")) {
          extended.push([at + 39, length - 37]);
        }
      }
      if (marker >= 0xc0 && marker <= 0xcf && marker !== 0xc4 && marker !== 0xc8 && marker !== 0xcc && !shape.blocks) {
        shape.blocks = blocksOf(head);
      } else if (marker === 0xdd) {
        shape.interval = (head[4] << 8) | head[5];
      }
      at += 2 + length;
    }
  }

  /* In how many blocks the picture is coded (ITU-T T.81 A.2): what restart intervals count. */
  function blocksOf(head) {
    var height = (head[5] << 8) | head[6], width = (head[7] << 8) | head[8], channels = head[9], across = 1, down = 1;
    for (var i = 11; channels > 1 && i < Math.min(10 + 3 * channels, head.length); i += 3) {
      across = Math.max(across, head[i] >> 4);
      down = Math.max(down, head[i] & 15);
    }
    return Math.ceil(width / (8 * across)) * Math.ceil(height / (8 * down));
  }

  /* Extended XMP is sent whole or, where it is larger than anybody reads, only by the head of each part. */
  function wantExtended(bytes, parts) {
    var total = parts.reduce(function (sum, part) { return sum + part[1]; }, 0);
    parts.forEach(function (part) {
      bytes.want(part[0], total > MOST_XMP_BYTES ? Math.min(40, part[1]) : part[1]);
    });
  }

  /* The end marker, wherever in the last 64 KB it stands: it says that the picture was copied whole. */
  function wantEnd(bytes, dataStart, extended, shape) {
    wantExtended(bytes, extended);
    var found = [2, 4096, 65536].some(function (span) {
      var offset = Math.max(dataStart, bytes.size - span);
      var data = bytes.look(offset, bytes.size - offset);
      for (var i = data.length - 2; i >= 0; i--) {
        if (data[i] === 0xff && data[i + 1] === 0xd9) return bytes.want(offset, bytes.size - offset);
      }
      if (span < 65536) bytes.asked.push([offset, bytes.size - offset]);
      return false;
    });
    bytes.endless = found ? null : { start: dataStart, blocks: shape.blocks, interval: shape.interval };
  }

  /* Whether a picture without an end among its last bytes is whole: it ends further up, or every restart interval has
     begun. The server cannot know, as it is not sent the picture. */
  function isWhole(file, told) {
    var restarts = 0, last = 0;
    function from(offset) {
      if (offset >= file.size) {
        return Boolean(told.interval) && restarts >= Math.ceil(told.blocks / told.interval) - 1;
      }
      return slice(file, offset, SEARCH_BYTES).then(function (data) {
        for (var i = 0; i < data.length; i++) {
          if (last === 0xff) {
            if (data[i] === 0xd9) return true;
            if (data[i] >= 0xd0 && data[i] <= 0xd7) restarts += 1;
          }
          last = data[i];
        }
        return from(offset + SEARCH_BYTES);
      });
    }
    return Promise.resolve(from(told.start));
  }

  function nextMarker(bytes, at) {
    var chunk = bytes.want(at, Math.min(STRAY_BYTES, bytes.size - at));
    for (var i = 0; i + 1 < chunk.length; i++) {
      if (chunk[i] === 0xff && chunk[i + 1] !== 0 && chunk[i + 1] !== 0xff) return at + i;
    }
    return -1;
  }

  function openStream(bytes, base, length) {
    var head = length >= 8 ? bytes.want(base, Math.min(16, length)) : null;
    if (!head || head[0] !== head[1] || (head[0] !== 0x49 && head[0] !== 0x4d)) return null;
    var stream = { bytes: bytes, base: base, length: length, little: head[0] === 0x49, big: false, first: 0 };
    var magic = number(stream, head, 2, 2);
    if (magic === 43 && head.length === 16) {
      stream.big = true;
      stream.first = number(stream, head, 8, 8);
    } else if (magic === 42) {
      stream.first = number(stream, head, 4, 4);
    } else {
      return null;
    }
    return stream;
  }

  function number(stream, data, at, length) {
    var value = 0;
    for (var i = 0; i < length; i++) value = value * 256 + data[stream.little ? at + length - 1 - i : at + i];
    return value;
  }

  function want(stream, offset, length) {
    if (offset < 0 || length < 0 || offset + length > stream.length) return null;
    return stream.bytes.want(stream.base + offset, length);
  }

  /* The fields of a directory as {tag: {type, count, offset}} and the offset of the next, null where damaged. */
  function directory(stream, offset) {
    var countSize = stream.big ? 8 : 2, entrySize = stream.big ? 20 : 12, inline = stream.big ? 8 : 4;
    if (offset < (stream.big ? 16 : 8)) return null;
    var head = want(stream, offset, countSize);
    var count = head ? number(stream, head, 0, countSize) : 0;
    if (count < 1 || count > MOST_ENTRIES) return null;
    var at = offset + countSize;
    var block = want(stream, at, count * entrySize);
    if (!block) return null;
    var fields = {};
    for (var i = 0; i < count; i++) {
      var entry = i * entrySize;
      var tag = number(stream, block, entry, 2), type = number(stream, block, entry + 2, 2);
      var many = number(stream, block, entry + 4, stream.big ? 8 : 4);
      if (!SIZES[type] || !many || fields[tag]) continue;
      var place = entry + entrySize - inline;
      var outside = many * SIZES[type] > inline;
      fields[tag] = { type: type, count: many, offset: outside ? number(stream, block, place, inline) : at + place };
    }
    var next = want(stream, at + count * entrySize, inline);
    return { fields: fields, next: next ? number(stream, next, 0, inline) : 0 };
  }

  /* The first whole numbers of a field. */
  function numbers(stream, field, most) {
    if (!field || field.type === 2 || field.type === 5 || field.type === 10 || field.type > 18) return [];
    var size = SIZES[field.type];
    var count = Math.min(field.count, most);
    var data = want(stream, field.offset, count * size);
    var found = [];
    for (var i = 0; data && i < count; i++) found.push(number(stream, data, i * size, size));
    return found;
  }

  function wantSmall(stream, fields) {
    Object.keys(fields).forEach(function (tag) {
      var field = fields[tag];
      var length = field.count * SIZES[field.type];
      var whole = Number(tag) === XMP_PACKET && length <= MOST_XMP_BYTES;
      if (Number(tag) === MAKER_NOTE || Number(tag) === USER_COMMENT || STRIPS.indexOf(Number(tag)) >= 0) return;
      if (whole || length <= TEXT_BYTES || field.type === 2) want(stream, field.offset, whole ? length : Math.min(length, TEXT_BYTES));
    });
  }

  function walkExif(stream, first) {
    if (!first) return;
    wantSmall(stream, first.fields);
    [EXIF_IFD, GPS_IFD].forEach(function (tag) {
      var offset = numbers(stream, first.fields[tag], 1)[0];
      var found = offset === undefined ? null : directory(stream, offset);
      if (found) wantSmall(stream, found.fields);
    });
  }

  function walkTiff(stream) {
    var queue = [stream.first], seen = {}, count = 0, first = null, best = null;
    while (queue.length && count < MOST_DIRECTORIES) {
      var offset = queue.shift();
      if (seen[offset]) continue;
      seen[offset] = true;
      count += 1;
      var found = directory(stream, offset);
      if (!found) continue;
      if (!first) first = found;
      var page = pageOf(stream, found.fields);
      if (page && (!best || (best.reduced && !page.reduced) || (best.reduced === page.reduced && page.area > best.area))) {
        best = page;
      }
      if (found.next) queue.push(found.next);
      queue = queue.concat(numbers(stream, found.fields[SUB_IFDS], MOST_SUB_DIRECTORIES));
    }
    walkExif(stream, first);
    if (best) STRIPS.forEach(function (tag) { numbers(stream, best.fields[tag], MOST_STRIPS); });
  }

  function pageOf(stream, fields) {
    [258, 259, 262, 277, 339].forEach(function (tag) { numbers(stream, fields[tag], 1); });
    var width = numbers(stream, fields[WIDTH], 1)[0], height = numbers(stream, fields[HEIGHT], 1)[0];
    if (!width || !height) return null;
    var kind = numbers(stream, fields[SUBFILE_TYPE], 1)[0] || 0;
    return { fields: fields, area: width * height, reduced: (kind & 5) !== 0 };
  }

  function slice(file, offset, length) {
    var blob = file.slice(offset, offset + length);
    if (blob.arrayBuffer) return blob.arrayBuffer().then(function (data) { return new Uint8Array(data); });
    return new Promise(function (resolve, reject) {
      var reader = new FileReader();
      reader.onload = function () { resolve(new Uint8Array(reader.result)); };
      reader.onerror = function () { reject(reader.error); };
      reader.readAsArrayBuffer(blob);
    });
  }

  /* Read [offset, length] pairs of a file as [offset, Uint8Array] pairs. */
  function readRanges(file, pairs) {
    return Promise.all(pairs.map(function (pair) {
      var length = Math.min(pair[1], Math.max(0, file.size - pair[0]));
      return slice(file, pair[0], length).then(function (data) { return [pair[0], data]; });
    }));
  }

  /* The ranges that hold a file's metadata: a promise of [[offset, Uint8Array], ...], rejected where it cannot be read,
     with `cut` where the picture breaks off. */
  function read(file) {
    var bytes = new Bytes(file.size);
    var steps = 0;
    function attempt() {
      bytes.asked = [];
      try {
        walk(bytes);
      } catch (missing) {
        if (!(missing instanceof Missing)) throw missing;
        if (++steps > MOST_STEPS) return finish();
        var length = Math.min(Math.max(missing.length, BLOCK_BYTES), file.size - missing.offset);
        return slice(file, missing.offset, length).then(function (data) {
          if (data.length < length) throw new Error("The file ended while it was being read.");
          bytes.add(missing.offset, data);
          return attempt();
        });
      }
      return finish();
    }
    function finish() {
      return bytes.ranges().map(function (range) {
        try {
          return [range[0], bytes.look(range[0], range[1])];
        } catch (missing) {
          if (!(missing instanceof Missing)) throw missing;
          return slice(file, range[0], range[1]).then(function (data) { return [range[0], data]; });
        }
      });
    }
    if (!file.size) return Promise.resolve([]);
    return slice(file, 0, Math.min(HEAD_BYTES, file.size)).then(function (data) {
      bytes.add(0, data);
      return attempt();
    }).then(function (ranges) { return Promise.all(ranges); }).then(function (ranges) {
      if (!bytes.endless) return ranges;
      return isWhole(file, bytes.endless).then(function (whole) {
        if (whole) return ranges;
        var error = new Error("The picture data breaks off: the file was not copied whole.");
        error.cut = true;
        throw error;
      });
    });
  }

  sensorgate.headers = { read: read, readRanges: readRanges };
})(window.sensorgate = window.sensorgate || {});
