"""Registration of scans: the picture sheet of an import, and scans whose truth is known."""
