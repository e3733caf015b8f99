"""Headers of image files: bytes to facts, within bounds, without decoding a pixel.

What could not be read as it should is noted in ``Frame.problems`` as
``code:detail``. The codes:

``exif-damaged``                a directory or value lies outside of the file
``exif-wrong-type``             text stands where a number belongs
``exif-not-utf8``               text in another encoding, read as Latin-1
``exif-rational-zero``          a fraction over zero
``exif-not-finite``             a NaN or an infinity
``exif-not-positive``           a value below zero, or a zero that means nothing
``focal-plane-rational-zero``   a focal-plane resolution over zero
``gps-out-of-range``            a position that is not on Earth
``jpeg-end-missing``            no end marker; every restart interval has begun, or only header bytes were given
``thermal-payload-incomplete``  some of FLIR's raw segments are missing
``xmp-doctype``                 a document type was declared: the packet is refused from there
``xmp-malformed``               no well-formed XML; what stands before the fault is read
``xmp-not-utf8``                another encoding, read as what its first bytes say or as Latin-1
``xmp-too-large``               more bytes or properties than the limits allow: not read
``xmp-extended-incomplete``     parts of the extended packet are missing
``xmp-multiple-descriptions``   that many ``rdf:Description`` blocks
``xmp-not-a-number``            a property that should be a number is none
``calibration-center-outside``  the principal point lies far from the middle: of another picture size
``calibration-focal-impossible`` a focal length that cannot be in pixels of this frame
"""
