"""The processes of one face (bridge, speech, supervisor), and the sockets that connect them."""
