/* Somebody presses the virtual camera's own button, as a remote release does: a picture and its events,
 * without a command and hence without a response. Included into vcamera.c before its vcam_write. */
static void press_if_asked(vcamera *cam) {
	struct ptpcontainer press = {0};
	int pending = cam->nrinbulk;
	unsigned int sequence = cam->seqnr;
	if (!cam->session || !fault_once("press")) return;
	press.seqnr = sequence;
	press.nparams = 2;
	ptp_initiatecapture_write(cam, &press);
	cam->nrinbulk = pending;
	cam->seqnr = sequence;
}
