"""The whole tract of one patient: stomach, small bowel and colon, apart or as one wall."""
