//! Downloads of flights from a recorder or `wingd serve`.

pub mod client;
pub mod fetch;

use std::path::Path;

use wingd_base::failure::{Failure, TaskResult};
use wingd_base::fault::Fault;
use wingd_base::output::byte_progress;
use wingd_pages::access;
use wingd_store::receive::Receiver;

use client::Client;

/// Page of a recorder or of `wingd serve`.
pub struct Download {
    url: String,
    client: Client,
}

impl Download {
    /// Opens a page with its access token and the certificate that it must present.
    ///
    /// # Errors
    /// Returns an error if a file cannot be read or the URL is not one.
    pub fn open(
        url: &str,
        token_file: Option<&Path>,
        certificate: Option<&Path>,
    ) -> TaskResult<Self> {
        let token = token_file.map(|file| {
            access::read_token(file)
                .map_err(|(problem, remedy)| Fault::new(file, "token", problem, remedy))
        });
        let client = Client::new(url, token.transpose()?, certificate);
        Ok(Self {
            url: url.to_owned(),
            client: client.map_err(|e| Failure::Failed(e.to_string()))?,
        })
    }

    /// Lists the flights of the page.
    ///
    /// # Errors
    /// Returns an error if the page does not answer.
    pub fn flight_names(&mut self) -> TaskResult<Vec<String>> {
        fetch::fetch_flight_names(&mut self.client).map_err(|error| failure(&self.url, &error))
    }

    /// Downloads the missing files of flights, or, if `thorough`, also the damaged ones.
    ///
    /// # Errors
    /// Returns an error if a flight cannot be received whole.
    pub fn receive(
        &mut self,
        receiver: &Receiver,
        flights: &[String],
        thorough: bool,
    ) -> TaskResult<()> {
        for flight in flights {
            let bar = byte_progress(0, flight);
            let mut progress = |done, total| {
                bar.set_length(total);
                bar.set_position(done);
            };
            fetch::fetch_flight(&mut self.client, receiver, flight, thorough, &mut progress)
                .map_err(|error| failure(&self.url, &error))?;
            bar.finish_and_clear();
        }
        Ok(())
    }
}

fn failure(url: &str, error: &fetch::FetchError) -> Failure {
    Failure::Failed(format!("{url}: {error}"))
}
